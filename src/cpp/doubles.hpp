// Four numbers at once, whatever the instruction set.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define VOILE_CLONES __attribute__((target_clones("default", "fma")))
#else
#define VOILE_CLONES
#endif
// What takes or returns a Double4 is inlined: its ABI, of which GCC warns, is nobody's.
#define VOILE_INLINED inline __attribute__((always_inline))
#pragma GCC diagnostic ignored "-Wpsabi"

namespace voile {

// Right-hand sides, or a vector's components, side by side, anywhere in an array of numbers.
typedef double Double4 __attribute__((vector_size(32), aligned(8), may_alias));

VOILE_INLINED Double4* fours(double* values) { return reinterpret_cast<Double4*>(values); }
VOILE_INLINED const Double4* fours(const double* values) { return reinterpret_cast<const Double4*>(values); }

}  // namespace voile
