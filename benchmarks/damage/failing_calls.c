/* Loaded before a program (LD_PRELOAD): makes the n-th system call on files under a folder fail, once.

   arm(folder, n, error) says which; failed() names the call that did, and seen() how many there were. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static char folder[4096], name[64];
static long at, count;
static int error;

void arm(const char *under, long n, int number) {
    snprintf(folder, sizeof folder, "%s", under);
    name[0] = 0, at = n, count = 0, error = number;
}
const char *failed(void) { return name; }
long seen(void) { return count; }

static int fails(const char *call, const char *path) {
    if (!folder[0] || strncmp(path, folder, strlen(folder)) || __atomic_add_fetch(&count, 1, __ATOMIC_SEQ_CST) != at)
        return 0;
    const char *file = strrchr(path, '/');
    snprintf(name, sizeof name, "%s %s", call, file ? file + 1 : path);
    errno = error;
    return 1;
}

static int fails_on(const char *call, int descriptor) {
    char link[64], path[4096];
    int before = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = folder[0] ? readlink(link, path, sizeof path - 1) : -1;
    errno = before;
    if (length < 0) return 0;
    path[length] = 0;
    return fails(call, path);
}

static int fails_at(const char *call, const char *path) {
    char whole[8192], here[4096];
    if (path[0] == '/') return fails(call, path);
    if (!folder[0] || !getcwd(here, sizeof here)) return 0;
    snprintf(whole, sizeof whole, "%s/%s", here, path);
    return fails(call, whole);
}

#define NEXT(call) ((__typeof__(call) *)dlsym(RTLD_NEXT, #call))
#define ON(type, call, arguments, given)                      \
    type call arguments {                                     \
        if (fails_on(#call, fd)) return -1;                   \
        return NEXT(call) given;                              \
    }
#define AT(call, arguments, given)                            \
    int call arguments {                                      \
        if (fails_at(#call, path)) return -1;                 \
        return NEXT(call) given;                              \
    }

ON(ssize_t, write, (int fd, const void *data, size_t size), (fd, data, size))
ON(ssize_t, pwrite, (int fd, const void *data, size_t size, off_t place), (fd, data, size, place))
ON(ssize_t, pwrite64, (int fd, const void *data, size_t size, off64_t place), (fd, data, size, place))
ON(ssize_t, read, (int fd, void *data, size_t size), (fd, data, size))
ON(ssize_t, pread, (int fd, void *data, size_t size, off_t place), (fd, data, size, place))
ON(ssize_t, pread64, (int fd, void *data, size_t size, off64_t place), (fd, data, size, place))
ON(int, fsync, (int fd), (fd))
ON(int, fdatasync, (int fd), (fd))
ON(int, ftruncate, (int fd, off_t size), (fd, size))
ON(int, ftruncate64, (int fd, off64_t size), (fd, size))
AT(mkdir, (const char *path, mode_t mode), (path, mode))
AT(unlink, (const char *path), (path))
AT(rename, (const char *path, const char *to), (path, to))

#define OPENS(call)                                           \
    int call(const char *path, int flags, ...) {              \
        va_list more;                                         \
        va_start(more, flags);                                \
        int mode = va_arg(more, int);                         \
        va_end(more);                                         \
        if (fails_at(#call, path)) return -1;                 \
        return NEXT(call)(path, flags, mode);                 \
    }
OPENS(open)
OPENS(open64)
