/* A disk that is watched: preloaded into a server, it records what reaches the files below DISK_ROOT, and fails, halves or
   ends at a call that it is told. record.rs reads the record, watched.rs has the form of the control file.

   Calls are made and recorded under one lock, so that the record has their true order. Whatever would write by a way that
   is not recorded ends the program: a record that misses something would prove nothing. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { FILES = 65536 };
enum how { NOTHING, ONCE, FROM_THEN_ON, SHORT, KILL, KILL_HALFWAY };

struct call { uint32_t what, process, handle, bytes; uint64_t at; };
struct control { uint64_t generation; uint32_t nth, calls, error, how; };
struct told { uint64_t counted, fired; };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static const char *root;
static int record_file = -1, control_file = -1, mute_syncs;
static uint32_t handles, handle_of[FILES];
static uint64_t syncs;
static struct control control;
static struct told told;
static int short_of = -1;

#define REAL(name) static __typeof__(&name) real; if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

static void record(char what, uint32_t handle, uint64_t at, const void *bytes, uint32_t count) {
    if (record_file < 0) return;
    struct call call = { (unsigned char)what, (uint32_t)getpid(), handle, count, at };
    struct iovec parts[2] = { { &call, sizeof call }, { (void *)bytes, count } };
    if (syscall(SYS_writev, record_file, parts, 2) != (long)(sizeof call + count)) abort();
}

__attribute__((constructor)) static void begin(void) {
    const char *name = getenv("DISK_RECORD");
    if (name) record_file = (int)syscall(SYS_openat, AT_FDCWD, name, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    name = getenv("DISK_CONTROL");
    if (name) control_file = (int)syscall(SYS_openat, AT_FDCWD, name, O_RDWR | O_CLOEXEC, 0);
    mute_syncs = getenv("DISK_MUTE_SYNCS") != NULL;
    root = getenv("DISK_ROOT");
    record('P', 0, 0, NULL, 0);
}

/* The part of a path below the root; NULL if it is elsewhere. */
static const char *below(const char *path) {
    size_t length = root ? strlen(root) : 0;
    if (!length || strncmp(path, root, length)) return NULL;
    return path[length] == '/' ? path + length + 1 : path[length] ? NULL : path + length;
}

static uint32_t handle(int file) { return file >= 0 && file < FILES ? handle_of[file] : 0; }

static void unrecorded(const char *call) {
    dprintf(2, "the watched disk does not record %s\n", call);
    abort();
}

/* What is to become of a call that is about to be made, under the lock: its error, or 0. */
static int fate(char what, int *half) {
    if (control_file < 0) return 0;
    struct control now;
    if (syscall(SYS_pread64, control_file, &now, sizeof now, 0) != (long)sizeof now) return 0;
    if (now.generation != control.generation) { control = now; memset(&told, 0, sizeof told); short_of = -1; }
    if (now.how == NOTHING || !(now.calls & 1u << (what - 'a'))) return 0;
    told.counted++;
    int fires = told.counted == now.nth || (now.how == FROM_THEN_ON && told.counted > now.nth);
    told.fired += (uint64_t)fires;
    syscall(SYS_pwrite64, control_file, &told, sizeof told, 32);
    if (!fires) return 0;
    switch ((enum how)now.how) {
    case NOTHING: return 0;
    case ONCE: case FROM_THEN_ON: return (int)now.error;
    case SHORT: case KILL_HALFWAY: if (half) { *half = 1; return 0; } break;
    case KILL: break;
    }
    if (now.how == SHORT) return (int)now.error;
    kill(getpid(), SIGKILL);
    for (;;) pause();
}

static int opens(int at, const char *path, int flags, mode_t mode) {
    const char *own = below(path);
    if (own) pthread_mutex_lock(&lock);
    int error = own ? fate('o', NULL) : 0;
    int file = error ? -1 : (int)syscall(SYS_openat, at, path, flags | O_LARGEFILE, mode);
    if (!error) error = errno;
    if (own && file >= 0 && file < FILES) {
        handle_of[file] = ++handles;
        uint64_t how = (uint64_t)(flags & O_CREAT ? 1 : 0) | (uint64_t)(flags & O_TRUNC ? 2 : 0);
        record('O', handles, how, own, (uint32_t)strlen(own));
    }
    if (own) pthread_mutex_unlock(&lock);
    errno = error;
    return file;
}

#define MODE(flags) \
    mode_t mode = 0; va_list rest; va_start(rest, flags); \
    if (flags & (O_CREAT | O_TMPFILE)) mode = va_arg(rest, mode_t); \
    va_end(rest)
int open(const char *path, int flags, ...) { MODE(flags); return opens(AT_FDCWD, path, flags, mode); }
int open64(const char *path, int flags, ...) { MODE(flags); return opens(AT_FDCWD, path, flags, mode); }
int openat(int at, const char *path, int flags, ...) { MODE(flags); return opens(at, path, flags, mode); }
int openat64(int at, const char *path, int flags, ...) { MODE(flags); return opens(at, path, flags, mode); }

int close(int file) {
    REAL(close);
    if (file >= 0 && file < FILES) handle_of[file] = 0;
    return real(file);
}

static ssize_t written(int file, const void *bytes, size_t count, off_t at) {
    int half = 0, error = 0;
    pthread_mutex_lock(&lock);
    if (short_of == file && control.how == SHORT) { short_of = -1; error = (int)control.error; }
    if (!error) error = fate('w', &half);
    ssize_t done = -1;
    if (!error) {
        done = syscall(SYS_pwrite64, file, bytes, half && count > 1 ? count / 2 : count, at);
        error = errno;
        if (done > 0) record('W', handle(file), (uint64_t)at, bytes, (uint32_t)done);
        if (half && control.how == KILL_HALFWAY) { kill(getpid(), SIGKILL); for (;;) pause(); }
        if (half) short_of = file;
    }
    pthread_mutex_unlock(&lock);
    errno = error;
    return done;
}

ssize_t pwrite(int file, const void *bytes, size_t count, off_t at) {
    REAL(pwrite);
    return handle(file) ? written(file, bytes, count, at) : real(file, bytes, count, at);
}
ssize_t pwrite64(int file, const void *bytes, size_t count, off64_t at) {
    REAL(pwrite64);
    return handle(file) ? written(file, bytes, count, at) : real(file, bytes, count, at);
}
ssize_t write(int file, const void *bytes, size_t count) {
    REAL(write);
    if (!handle(file)) return real(file, bytes, count);
    if (fcntl(file, F_GETFL) & O_APPEND) unrecorded("appending");
    off_t at = lseek(file, 0, SEEK_CUR);
    ssize_t done = written(file, bytes, count, at);
    if (done > 0) lseek(file, at + done, SEEK_SET);
    return done;
}

#define READS(name, parameters, arguments) \
    ssize_t name parameters { \
        REAL(name); \
        if (!handle(file)) return real arguments; \
        pthread_mutex_lock(&lock); int error = fate('r', NULL); pthread_mutex_unlock(&lock); \
        if (error) { errno = error; return -1; } \
        return real arguments; }
READS(read, (int file, void *bytes, size_t count), (file, bytes, count))
READS(pread, (int file, void *bytes, size_t count, off_t at), (file, bytes, count, at))
READS(pread64, (int file, void *bytes, size_t count, off64_t at), (file, bytes, count, at))

#define SYNCS(name) \
    int name(int file) { \
        REAL(name); uint32_t own = handle(file); \
        if (!own) return real(file); \
        pthread_mutex_lock(&lock); \
        int error = fate('s', NULL); uint64_t number = ++syncs; \
        if (!error) record('B', own, number, NULL, 0); \
        pthread_mutex_unlock(&lock); \
        if (error) { errno = error; return -1; } \
        int failed = mute_syncs ? 0 : real(file); \
        error = errno; \
        pthread_mutex_lock(&lock); record(failed ? 'X' : 'E', own, number, NULL, 0); pthread_mutex_unlock(&lock); \
        errno = error; \
        return failed; }
SYNCS(fsync)
SYNCS(fdatasync)

#define TRUNCATES(name, kind) \
    int name(int file, kind size) { \
        REAL(name); \
        if (!handle(file)) return real(file, size); \
        pthread_mutex_lock(&lock); \
        int error = fate('t', NULL), failed = error ? -1 : real(file, size); \
        if (!error) error = errno; \
        if (!failed) record('T', handle(file), (uint64_t)size, NULL, 0); \
        pthread_mutex_unlock(&lock); \
        errno = error; \
        return failed; }
TRUNCATES(ftruncate, off_t)
TRUNCATES(ftruncate64, off64_t)

#define NAMES(name, parameters, arguments, letter, sign) \
    int name parameters { \
        REAL(name); const char *own = below(path); \
        if (!own) return real arguments; \
        pthread_mutex_lock(&lock); \
        int error = fate(letter, NULL), failed = error ? -1 : real arguments; \
        if (!error) error = errno; \
        if (!failed) record(sign, 0, 0, own, (uint32_t)strlen(own)); \
        pthread_mutex_unlock(&lock); \
        errno = error; \
        return failed; }
NAMES(unlink, (const char *path), (path), 'u', 'U')
NAMES(mkdir, (const char *path, mode_t mode), (path, mode), 'd', 'D')

int rename(const char *path, const char *to) {
    REAL(rename); const char *own = below(path), *other = below(to);
    if (!own || !other) return real(path, to);
    pthread_mutex_lock(&lock);
    int error = fate('n', NULL), failed = error ? -1 : real(path, to);
    if (!error) error = errno;
    if (!failed) {
        char names[8192];
        int length = snprintf(names, sizeof names, "%s%c%s", own, 0, other);
        if (length < 0 || length >= (int)sizeof names) abort();
        record('N', 0, 0, names, (uint32_t)length);
    }
    pthread_mutex_unlock(&lock);
    errno = error;
    return failed;
}

/* Ways that are left to be gone another way round. */
ssize_t copy_file_range(int from, off64_t *from_at, int to, off64_t *to_at, size_t count, unsigned flags) {
    REAL(copy_file_range);
    if (!handle(from) && !handle(to)) return real(from, from_at, to, to_at, count, flags);
    errno = ENOSYS;
    return -1;
}
ssize_t sendfile64(int to, int from, off64_t *at, size_t count) {
    static ssize_t (*real)(int, int, off64_t *, size_t);
    if (!real) real = (ssize_t (*)(int, int, off64_t *, size_t))dlsym(RTLD_NEXT, "sendfile64");
    if (!handle(from) && !handle(to)) return real(to, from, at, count);
    errno = EINVAL;
    return -1;
}

/* Ways that nobody goes. */
#define NEVER(name, parameters, arguments) \
    ssize_t name parameters { REAL(name); if (handle(file)) unrecorded(#name); return real arguments; }
NEVER(writev, (int file, const struct iovec *parts, int count), (file, parts, count))
NEVER(pwritev, (int file, const struct iovec *parts, int count, off_t at), (file, parts, count, at))
NEVER(pwritev64, (int file, const struct iovec *parts, int count, off64_t at), (file, parts, count, at))
#define NEVER_INT(name, parameters, arguments) \
    int name parameters { REAL(name); if (handle(file)) unrecorded(#name); return real arguments; }
NEVER_INT(fallocate, (int file, int mode, off_t at, off_t count), (file, mode, at, count))
NEVER_INT(fallocate64, (int file, int mode, off64_t at, off64_t count), (file, mode, at, count))
NEVER_INT(posix_fallocate, (int file, off_t at, off_t count), (file, at, count))
NEVER_INT(posix_fallocate64, (int file, off64_t at, off64_t count), (file, at, count))
#define NEVER_NAMED(name, parameters, arguments) \
    int name parameters { REAL(name); if (below(path)) unrecorded(#name); return real arguments; }
NEVER_NAMED(link, (const char *path, const char *to), (path, to))
NEVER_NAMED(symlink, (const char *to, const char *path), (to, path))
NEVER_NAMED(truncate, (const char *path, off_t size), (path, size))
NEVER_NAMED(truncate64, (const char *path, off64_t size), (path, size))
NEVER_NAMED(rmdir, (const char *path), (path))
