// Preloaded into a run: kills it after TORN_AT bytes written to files under the folder TORN_IN, in the midst of a write
// where that is so; other changes of files there (new names, sizes, removals) count as a byte. Without TORN_AT the
// process tells at its end on file descriptor TORN_TO how many there were.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static long long done;

static int inside(int fd) {
  const char* folder = getenv("TORN_IN");
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  ssize_t n = readlink(link, path, sizeof path - 1);
  if (n <= 0 || !folder) return 0;
  path[n] = 0;
  return !strncmp(path, folder, strlen(folder));
}

// How many of n bytes may still be written; kills where that is none.
static size_t left(size_t n) {
  const char* at = getenv("TORN_AT");
  if (!at) return done += n, n;
  long long more = atoll(at) - done;
  if (more <= 0) kill(getpid(), SIGKILL);
  size_t share = more < (long long)n ? (size_t)more : n;
  done += n;
  return share;
}

__attribute__((destructor)) static void tell(void) {
  const char* to = getenv("TORN_TO");
  if (to && done) dprintf(atoi(to), "%lld\n", done);
}

#define WRITES(name, parameters, arguments)                                      \
  ssize_t name parameters {                                                      \
    static ssize_t(*real) parameters;                                            \
    if (!real) *(void**)&real = dlsym(RTLD_NEXT, #name);                         \
    size_t asked = n;                                                            \
    if (inside(fd)) n = left(n);                                                 \
    ssize_t written = real arguments;                                            \
    if (n < asked) kill(getpid(), SIGKILL);                                      \
    return written;                                                              \
  }
WRITES(write, (int fd, const void* data, size_t n), (fd, data, n))
WRITES(pwrite, (int fd, const void* data, size_t n, off_t at), (fd, data, n, at))
WRITES(pwrite64, (int fd, const void* data, size_t n, off64_t at), (fd, data, n, at))

#define CHANGES(name, parameters, arguments, counts)     \
  int name parameters {                                  \
    static int(*real) parameters;                        \
    if (!real) *(void**)&real = dlsym(RTLD_NEXT, #name); \
    if (counts) left(1);                                 \
    return real arguments;                               \
  }
static int under(const char* path) {
  const char* folder = getenv("TORN_IN");
  return folder && !strncmp(path, folder, strlen(folder));
}
CHANGES(rename, (const char* from, const char* to), (from, to), under(to))
CHANGES(unlink, (const char* path), (path), under(path))
CHANGES(ftruncate, (int fd, off_t size), (fd, size), inside(fd))
CHANGES(ftruncate64, (int fd, off64_t size), (fd, size), inside(fd))
CHANGES(posix_fallocate, (int fd, off_t at, off_t size), (fd, at, size), inside(fd))
CHANGES(posix_fallocate64, (int fd, off64_t at, off64_t size), (fd, at, size), inside(fd))
