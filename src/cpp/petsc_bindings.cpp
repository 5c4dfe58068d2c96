// Python module voile._petsc, what petsc4py lacks: the value arrays of an AIJ matrix, so that assembly writes
// into them directly instead of copies, and the options that nothing used.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <petscmat.h>

#include <stdexcept>
#include <string>

namespace nb = nanobind;

static void check(PetscErrorCode code) {
  if (code) throw std::runtime_error("PETSc error " + std::to_string((int)code));
}

template <class T>
static nb::ndarray<nb::numpy, T> view(T* data, size_t size) {
  return nb::ndarray<nb::numpy, T>(data, {size}, nb::none());
}

// (row starts, columns, values) of a sequential AIJ matrix.
static nb::tuple sequential(Mat mat) {
  static_assert(sizeof(PetscInt) == 4, "Voile expects PETSc with 32-bit indices");
  const PetscInt *ia, *ja;
  PetscInt rows;
  PetscBool done;
  PetscScalar* values;
  check(MatGetRowIJ(mat, 0, PETSC_FALSE, PETSC_FALSE, &rows, &ia, &ja, &done));
  if (!done) throw std::runtime_error("the matrix is not in AIJ format");
  check(MatSeqAIJGetArray(mat, &values));
  size_t entries = (size_t)ia[rows];
  auto result = nb::make_tuple(view(const_cast<int32_t*>(ia), (size_t)rows + 1),
                               view(const_cast<int32_t*>(ja), entries), view(values, entries));
  check(MatSeqAIJRestoreArray(mat, &values));
  check(MatRestoreRowIJ(mat, 0, PETSC_FALSE, PETSC_FALSE, &rows, &ia, &ja, &done));
  return result;
}

// Views, valid as long as the matrix: ((ia, ja, values) of this rank's columns, the same of the others'
// columns or None, global columns of the latter). handle: petsc4py's Mat.handle.
static nb::tuple aij_arrays(uintptr_t handle) {
  Mat mat = reinterpret_cast<Mat>(handle);
  PetscBool distributed;
  check(PetscObjectTypeCompare((PetscObject)mat, MATMPIAIJ, &distributed));
  if (!distributed) return nb::make_tuple(sequential(mat), nb::none(), nb::none());
  Mat inside, outside;
  const PetscInt* columns;
  PetscInt count;
  check(MatMPIAIJGetSeqAIJ(mat, &inside, &outside, &columns));
  check(MatGetSize(outside, nullptr, &count));
  return nb::make_tuple(sequential(inside), sequential(outside),
                        view(const_cast<int32_t*>(columns), (size_t)count));
}

// (name, value) of the options in PETSc's database that nothing has asked for; "" for none.
static nb::list unused_options() {
  PetscInt count;
  char **names, **values;
  check(PetscOptionsLeftGet(nullptr, &count, &names, &values));
  nb::list found;
  for (PetscInt i = 0; i < count; ++i) found.append(nb::make_tuple(names[i], values[i] ? values[i] : ""));
  check(PetscOptionsLeftRestore(nullptr, &count, &names, &values));
  return found;
}

NB_MODULE(_petsc, m) {
  m.doc() = "Arrays of PETSc matrices, unused PETSc options.";
  m.def("aij_arrays", &aij_arrays);
  m.def("unused_options", &unused_options);
}
