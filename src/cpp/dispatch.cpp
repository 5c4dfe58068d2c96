// Chooses at run time among the builds of elastic.cpp.
#include <cstdlib>
#include <stdexcept>

#include "elastic.hpp"

namespace voile {

#define VOILE_BUILD(isa)                                                     \
  namespace isa {                                                            \
  std::unique_ptr<Elastic> make_elastic(const std::string& name, Mesh mesh); \
  }
VOILE_BUILD(baseline)
#ifdef VOILE_HAVE_X86
VOILE_BUILD(avx2)
VOILE_BUILD(avx512)
#endif

std::string instruction_set() {
  const char* wanted = std::getenv("VOILE_ISA");
  std::string name = wanted ? wanted : "";
#ifdef VOILE_HAVE_X86
  bool has512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw");
  bool has2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  if (has512 && (name.empty() || name == "avx512")) return "avx512";
  if (has2 && (name.empty() || name == "avx2")) return "avx2";
#endif
  if (name.empty() || name == "baseline") return "baseline";
  throw std::invalid_argument("VOILE_ISA=" + name +
                              " is not available here; allowed: baseline, avx2, avx512");
}

std::unique_ptr<Elastic> make_elastic(const std::string& name, Mesh mesh) {
  std::string isa = instruction_set();
#ifdef VOILE_HAVE_X86
  if (isa == "avx512") return avx512::make_elastic(name, std::move(mesh));
  if (isa == "avx2") return avx2::make_elastic(name, std::move(mesh));
#endif
  return baseline::make_elastic(name, std::move(mesh));
}

}  // namespace voile
