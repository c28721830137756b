/* A disk that fails: preloaded, it lets system calls on files below one folder fail.
 *
 *     cc -shared -fPIC -O1 -o faults.so tests/faults.c -ldl; LD_PRELOAD=./faults.so python tests/faults.py
 *
 * fault_arm says which calls, from which one on, how many of them, and with which error; fault_count how many there were.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

enum { WRITE, FSYNC, RENAME, LINK, MKDIR, CREATE, TRUNCATE, KINDS };

static char folder[PATH_MAX];
static unsigned kinds;               /* bit by kind: those that fail */
static long first, number, error;    /* the first that fails, how many do, and errno */
static long counts[KINDS], failing;  /* calls so far: by kind, and of those that fail */

void fault_arm(const char *below, unsigned which, long from, long many, long code) {
  strncpy(folder, below, sizeof folder - 1);
  kinds = which, first = from, number = many, error = code, failing = 0;
  memset(counts, 0, sizeof counts);
}

long fault_count(int kind) { return counts[kind]; }

static int fails(int kind, const char *path) {
  if (!folder[0] || !path || strncmp(path, folder, strlen(folder))) return 0;
  __atomic_add_fetch(&counts[kind], 1, __ATOMIC_SEQ_CST);
  if (!(kinds >> kind & 1)) return 0;
  long k = __atomic_add_fetch(&failing, 1, __ATOMIC_SEQ_CST);
  if (k < first || k >= first + number) return 0;
  errno = (int)error;
  return 1;
}

static int fails_open(int kind, int descriptor) {
  char name[64], path[PATH_MAX];
  if (!folder[0]) return 0;
  snprintf(name, sizeof name, "/proc/self/fd/%d", descriptor);
  ssize_t length = readlink(name, path, sizeof path - 1);
  if (length < 0) return 0;
  path[length] = 0;
  return fails(kind, path);
}

static int fails_at(int kind, const char *name) {
  char path[2 * PATH_MAX], here[PATH_MAX];
  if (!folder[0] || !name) return 0;
  if (name[0] == '/') return fails(kind, name);
  if (!getcwd(here, sizeof here)) return 0;
  snprintf(path, sizeof path, "%s/%s", here, name);
  return fails(kind, path);
}

#define NEXT(type, name) \
  static type (*next)();  \
  if (!next) next = (type(*)())dlsym(RTLD_NEXT, name)

ssize_t write(int d, const void *b, size_t n) {
  NEXT(ssize_t, "write");
  return fails_open(WRITE, d) ? -1 : next(d, b, n);
}
ssize_t pwrite(int d, const void *b, size_t n, off_t at) {
  NEXT(ssize_t, "pwrite");
  return fails_open(WRITE, d) ? -1 : next(d, b, n, at);
}
ssize_t pwrite64(int d, const void *b, size_t n, off64_t at) {
  NEXT(ssize_t, "pwrite64");
  return fails_open(WRITE, d) ? -1 : next(d, b, n, at);
}
ssize_t writev(int d, const struct iovec *v, int n) {
  NEXT(ssize_t, "writev");
  return fails_open(WRITE, d) ? -1 : next(d, v, n);
}
int fsync(int d) {
  NEXT(int, "fsync");
  return fails_open(FSYNC, d) ? -1 : next(d);
}
int fdatasync(int d) {
  NEXT(int, "fdatasync");
  return fails_open(FSYNC, d) ? -1 : next(d);
}
int rename(const char *a, const char *b) {
  NEXT(int, "rename");
  return fails_at(RENAME, b) ? -1 : next(a, b);
}
int renameat2(int x, const char *a, int y, const char *b, unsigned flags) {
  NEXT(int, "renameat2");
  return fails_at(RENAME, b) ? -1 : next(x, a, y, b, flags);
}
int link(const char *a, const char *b) {
  NEXT(int, "link");
  return fails_at(LINK, b) ? -1 : next(a, b);
}
int linkat(int x, const char *a, int y, const char *b, int flags) {
  NEXT(int, "linkat");
  return fails_at(LINK, b) ? -1 : next(x, a, y, b, flags);
}
int mkdir(const char *a, mode_t mode) {
  NEXT(int, "mkdir");
  return fails_at(MKDIR, a) ? -1 : next(a, mode);
}
int ftruncate(int d, off_t n) {
  NEXT(int, "ftruncate");
  return fails_open(TRUNCATE, d) ? -1 : next(d, n);
}
int ftruncate64(int d, off64_t n) {
  NEXT(int, "ftruncate64");
  return fails_open(TRUNCATE, d) ? -1 : next(d, n);
}

#define OPEN(name)                                                         \
  int name(const char *a, int flags, ...) {                                \
    va_list more;                                                          \
    va_start(more, flags);                                                 \
    mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0; \
    va_end(more);                                                          \
    NEXT(int, #name);                                                      \
    if ((flags & O_CREAT) && fails_at(CREATE, a)) return -1;               \
    return next(a, flags, mode);                                           \
  }
OPEN(open)
OPEN(open64)
