/* Preloaded into an engine: a fault at one call among those that change a folder.
 *
 * Calls are told apart by their name and by the file that they are for (digits and the random part
 * of temporary names left out), so that threads which take turns in another order do not change
 * which one is meant. What is counted lies in a file that all threads and all processes share.
 *
 * EACH_CALL_FOLDER  absolute: what lies in it counts
 * EACH_CALL_STATE   a file of zeros for the counts
 * EACH_CALL_LOG     every call that counts, one line each
 * EACH_CALL_NAME, EACH_CALL_FILE, EACH_CALL_NUMBER  the one call; no number: none
 * EACH_CALL_FAULT   kill | power | hang | a number of errno
 * EACH_CALL_HANG    s
 */
#define _GNU_SOURCE
#include <ctype.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

#define SHUTDOWN 0x8004587D /* FS_IOC_SHUTDOWN */
#define NO_LOGFLUSH 2

struct shared {
    atomic_long seen;       /* calls of the kind that is meant */
    atomic_long fired;      /* whether the fault came */
    atomic_llong hangs_to;  /* monotonic ns: until then no call comes back */
    atomic_llong came_at;   /* monotonic ns */
};

static char folder[PATH_MAX];
static size_t folder_length;
static struct shared *shared;
static int log_fd = -1;
static const char *wanted_name = "", *wanted_file = "", *fault = "";
static long wanted_number;
static double hang;

static long long now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

/* Read the environment; called when the library is loaded, and again by a process that forked. */
void each_call_arm(void) {
    const char *where = getenv("EACH_CALL_FOLDER"), *number = getenv("EACH_CALL_NUMBER");
    const char *state = getenv("EACH_CALL_STATE"), *log = getenv("EACH_CALL_LOG");
    folder_length = 0;
    if (where == NULL || state == NULL || log == NULL || strlen(where) >= sizeof folder) return;
    int fd = syscall(SYS_openat, AT_FDCWD, state, O_RDWR | O_CLOEXEC, 0);
    if (fd < 0) return;
    shared = mmap(NULL, sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    syscall(SYS_close, fd);
    if (shared == MAP_FAILED) return;
    log_fd = syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_APPEND | O_CLOEXEC, 0);
    if (log_fd >= 0) { /* out of the way of those who close low numbers */
        int high = fcntl(log_fd, F_DUPFD_CLOEXEC, 900);
        if (high >= 0) {
            syscall(SYS_close, log_fd);
            log_fd = high;
        }
    }
    wanted_number = number == NULL ? 0 : atol(number);
    wanted_name = getenv("EACH_CALL_NAME") ? strdup(getenv("EACH_CALL_NAME")) : "";
    wanted_file = getenv("EACH_CALL_FILE") ? strdup(getenv("EACH_CALL_FILE")) : "";
    fault = getenv("EACH_CALL_FAULT") ? strdup(getenv("EACH_CALL_FAULT")) : "";
    hang = getenv("EACH_CALL_HANG") ? atof(getenv("EACH_CALL_HANG")) : 0;
    strcpy(folder, where);
    folder_length = strlen(folder);
}

__attribute__((constructor)) static void loaded(void) { each_call_arm(); }

/* The absolute path of what an open file or folder is; 0 if there is none. */
static int path_of(int fd, char *path) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = syscall(SYS_readlinkat, AT_FDCWD, link, path, PATH_MAX - 1);
    if (n <= 0) return 0;
    path[n] = 0;
    return path[0] == '/';
}

static int whole_path(int dir, const char *name, char *path) {
    char base[PATH_MAX];
    if (name == NULL) return 0;
    const char *rest = strncmp(name, "/proc/", 6) == 0 ? strstr(name, "/fd/") : NULL;
    if (rest != NULL) { /* the way into an open folder */
        for (rest += 4; isdigit((unsigned char)*rest); rest++) {}
        snprintf(path, PATH_MAX, "%.*s", (int)(rest - name), name);
        ssize_t n = syscall(SYS_readlinkat, AT_FDCWD, path, base, PATH_MAX - 1);
        if (n <= 0) return 0;
        base[n] = 0;
        return snprintf(path, PATH_MAX, "%s%s", base, rest) < PATH_MAX;
    }
    if (name[0] == '/') return snprintf(path, PATH_MAX, "%s", name) < PATH_MAX;
    if (dir == AT_FDCWD) {
        if (syscall(SYS_getcwd, base, sizeof base) <= 0) return 0;
    } else if (!path_of(dir, base)) {
        return 0;
    }
    return snprintf(path, PATH_MAX, "%s/%s", base, name) < PATH_MAX;
}

/* The last part of a path without what differs from run to run. */
static void file_of(const char *path, char *file, size_t size) {
    const char *last = path[folder_length] == 0 ? "/" : strrchr(path, '/') + 1;
    size_t length = strlen(last), at = 0;
    if (length > 14 && strcmp(last + length - 5, ".part") == 0) length -= 14; /* .01234567.part */
    for (size_t i = 0; i < length && at + 1 < size; i++) {
        if (!isdigit((unsigned char)last[i])) file[at++] = last[i];
        else if (at == 0 || file[at - 1] != '#') file[at++] = '#';
    }
    file[at] = 0;
}

static void wait_for_disk(void) {
    for (;;) {
        long long left = atomic_load(&shared->hangs_to) - now_ns();
        if (left <= 0) return;
        struct timespec t = {left / 1000000000LL, left % 1000000000LL};
        nanosleep(&t, NULL);
    }
}

/* A call is about to be made: 0, or the number of the error with which it fails. */
/* The engine leads its group; what makes its pages, a child of it, leads one of its own. */
static void end_all(void)
{
    char line[4096];
    long file = syscall(SYS_openat, AT_FDCWD, "/proc/self/cmdline", O_RDONLY);
    long length = file < 0 ? 0 : syscall(SYS_read, file, line, sizeof line - 1);
    for (long i = 0; i < length; i++)
        if (!line[i])
            line[i] = ' ';
    line[length > 0 ? length : 0] = 0;
    if (strstr(line, "cli.chore_worker") && getppid() > 1)
        kill(-getpgid(getppid()), SIGKILL);
    kill(0, SIGKILL);
}

static int about_to(const char *name, const char *path) {
    if (folder_length == 0 || strncmp(path, folder, folder_length) != 0) return 0;
    if (path[folder_length] != '/' && path[folder_length] != 0) return 0;
    char file[256], line[400];
    file_of(path, file, sizeof file);
    int n = snprintf(line, sizeof line, "%s %s\n", name, file);
    if (log_fd >= 0) syscall(SYS_write, log_fd, line, n);
    if (wanted_number == 0) return 0;
    if (strcmp(name, wanted_name) == 0 && strcmp(file, wanted_file) == 0 &&
        atomic_fetch_add(&shared->seen, 1) + 1 == wanted_number) {
        atomic_store(&shared->came_at, now_ns());
        atomic_store(&shared->fired, 1);
        if (strcmp(fault, "power") == 0) {
            int how = NO_LOGFLUSH, fd = syscall(SYS_openat, AT_FDCWD, folder, O_RDONLY, 0);
            syscall(SYS_ioctl, fd, SHUTDOWN, &how);
        }
        if (strcmp(fault, "power") == 0 || strcmp(fault, "kill") == 0) {
            end_all();
            for (;;) pause();
        }
        if (strcmp(fault, "hang") == 0)
            atomic_store(&shared->hangs_to, now_ns() + (long long)(hang * 1e9));
        else
            return atoi(fault);
    }
    wait_for_disk();
    return 0;
}

static int at(const char *name, int dir, const char *path) {
    char whole[PATH_MAX];
    if (folder_length == 0) return 0;
    int before = errno, failed = whole_path(dir, path, whole) ? about_to(name, whole) : 0;
    errno = failed ? failed : before;
    return failed;
}

static int with(const char *name, int fd) {
    char whole[PATH_MAX];
    if (folder_length == 0) return 0;
    int before = errno, failed = path_of(fd, whole) ? about_to(name, whole) : 0;
    errno = failed ? failed : before;
    return failed;
}

#define REAL(type, name, ...)                                     \
    static type (*real)(__VA_ARGS__);                             \
    if (real == NULL) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name)

#define OPENED(flags) ((flags) & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC) ? "open" : "look")

#define OPEN(name)                                                \
    int name(const char *path, int flags, ...) {                  \
        va_list more;                                             \
        va_start(more, flags);                                    \
        mode_t mode = va_arg(more, mode_t);                       \
        va_end(more);                                             \
        REAL(int, name, const char *, int, ...);                  \
        if (at(OPENED(flags), AT_FDCWD, path)) return -1;         \
        return real(path, flags, mode);                           \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                              \
    int name(int dir, const char *path, int flags, ...) {         \
        va_list more;                                             \
        va_start(more, flags);                                    \
        mode_t mode = va_arg(more, mode_t);                       \
        va_end(more);                                             \
        REAL(int, name, int, const char *, int, ...);             \
        if (at(OPENED(flags), dir, path)) return -1;              \
        return real(dir, path, flags, mode);                      \
    }
OPENAT(openat)
OPENAT(openat64)

#define ON_FILE(type, name, as, parameters, arguments)            \
    type name parameters {                                        \
        static type(*real) parameters;                            \
        if (real == NULL) real = (type(*) parameters)dlsym(RTLD_NEXT, #name); \
        if (with(as, fd)) return -1;                              \
        return real arguments;                                    \
    }
ON_FILE(ssize_t, write, "write", (int fd, const void *data, size_t n), (fd, data, n))
ON_FILE(ssize_t, writev, "write", (int fd, const struct iovec *data, int n), (fd, data, n))
ON_FILE(ssize_t, pwrite, "write", (int fd, const void *d, size_t n, off_t o), (fd, d, n, o))
ON_FILE(ssize_t, pwrite64, "write", (int fd, const void *d, size_t n, off64_t o), (fd, d, n, o))
ON_FILE(ssize_t, sendfile, "write", (int fd, int in, off_t *o, size_t n), (fd, in, o, n))
ON_FILE(ssize_t, sendfile64, "write", (int fd, int in, off64_t *o, size_t n), (fd, in, o, n))
ON_FILE(int, fsync, "fsync", (int fd), (fd))
ON_FILE(int, fdatasync, "fdatasync", (int fd), (fd))
ON_FILE(int, ftruncate, "truncate", (int fd, off_t n), (fd, n))
ON_FILE(int, ftruncate64, "truncate", (int fd, off64_t n), (fd, n))
ON_FILE(int, fchmod, "chmod", (int fd, mode_t mode), (fd, mode))

#define ON_PATH(name, as, parameters, dir, path, arguments)       \
    int name parameters {                                         \
        static int(*real) parameters;                             \
        if (real == NULL) real = (int(*) parameters)dlsym(RTLD_NEXT, #name); \
        if (at(as, dir, path)) return -1;                         \
        return real arguments;                                    \
    }
ON_PATH(rename, "rename", (const char *a, const char *b), AT_FDCWD, b, (a, b))
ON_PATH(renameat, "rename", (int c, const char *a, int d, const char *b), d, b, (c, a, d, b))
ON_PATH(renameat2, "rename", (int c, const char *a, int d, const char *b, unsigned int f), d, b,
        (c, a, d, b, f))
ON_PATH(link, "link", (const char *a, const char *b), AT_FDCWD, b, (a, b))
ON_PATH(linkat, "link", (int c, const char *a, int d, const char *b, int f), d, b, (c, a, d, b, f))
ON_PATH(symlink, "symlink", (const char *a, const char *b), AT_FDCWD, b, (a, b))
ON_PATH(symlinkat, "symlink", (const char *a, int d, const char *b), d, b, (a, d, b))
ON_PATH(unlink, "unlink", (const char *a), AT_FDCWD, a, (a))
ON_PATH(unlinkat, "unlink", (int d, const char *a, int f), d, a, (d, a, f))
ON_PATH(mkdir, "mkdir", (const char *a, mode_t m), AT_FDCWD, a, (a, m))
ON_PATH(mkdirat, "mkdir", (int d, const char *a, mode_t m), d, a, (d, a, m))
ON_PATH(rmdir, "rmdir", (const char *a), AT_FDCWD, a, (a))
ON_PATH(truncate, "truncate", (const char *a, off_t n), AT_FDCWD, a, (a, n))
ON_PATH(truncate64, "truncate", (const char *a, off64_t n), AT_FDCWD, a, (a, n))
ON_PATH(chmod, "chmod", (const char *a, mode_t m), AT_FDCWD, a, (a, m))
