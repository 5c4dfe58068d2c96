// What the direct solvers need of BLAS and LAPACK.
#pragma once

extern "C" {
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
void dgetrf_(const int* m, const int* n, double* a, const int* lda, int* pivots, int* info);
void dtrsm_(const char* side, const char* uplo, const char* trans, const char* diagonal, const int* m,
            const int* n, const double* alpha, const double* a, const int* lda, double* b, const int* ldb);
void dsyrk_(const char* uplo, const char* trans, const int* n, const int* k, const double* alpha,
            const double* a, const int* lda, const double* beta, double* c, const int* ldc);
void dgemm_(const char* transa, const char* transb, const int* m, const int* n, const int* k,
            const double* alpha, const double* a, const int* lda, const double* b, const int* ldb,
            const double* beta, double* c, const int* ldc);
void dtrsv_(const char* uplo, const char* trans, const char* diagonal, const int* n, const double* a,
            const int* lda, double* x, const int* step);
void dgemv_(const char* trans, const int* m, const int* n, const double* alpha, const double* a,
            const int* lda, const double* x, const int* xstep, const double* beta, double* y,
            const int* ystep);
void dgelss_(const int* m, const int* n, const int* sides, double* a, const int* lda, double* b,
             const int* ldb, double* singular, const double* faint, int* rank, double* work, const int* room,
             int* info);
void dlaswp_(const int* n, double* a, const int* lda, const int* k1, const int* k2, const int* pivots,
             const int* step);
}
