/* Simulation of a power loss: preloaded into a run, it ends the run at a chosen point like a kill or a power loss.
 *
 *   MAGLINE_SHIM_ROOT   the folder that is watched
 *   MAGLINE_SHIM_COUNT  a file that receives the number of points when the process ends normally
 *   MAGLINE_SHIM_AT     the point, from 1, before which the process ends
 *   MAGLINE_SHIM_MODE   `kill`: ends the process; `power`: drops unsynced data first
 *   MAGLINE_SHIM_SEED   selection of the dropped data: 0 all, otherwise each with probability 1/2
 *
 * A point is a rename, link, symlink or fsync below the root. A file loses the bytes written since its last fsync:
 * all or half of them are cut off, or they become zeros. A change of a folder (a name that was added, removed or replaced)
 * is undone unless the folder was synced afterwards. A rename is one change, of the target folder. Calls are serialised
 * and go directly to the kernel, so that the shim does not intercept its own calls. */
#define _GNU_SOURCE
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define RENAME_EXCHANGE_FLAG 2

/* A file with bytes that are not on the disk. */
struct dirty {
    dev_t dev;
    ino_t ino;
    int fd;         /* descriptor of the shim, so that the file is found under any name */
    off_t synced;   /* number of bytes on the disk */
};

/* A name in a folder, with a descriptor of the folder, because the folder may be renamed. */
struct place {
    int folder;
    dev_t dev;
    ino_t ino;
    char name[NAME_MAX + 1];
};

enum kind { MADE, GONE, MOVED };

/* A change of a folder that is not on the disk. */
struct change {
    enum kind kind;
    struct place at;     /* the folder that has to be synced, and the name */
    struct place from;   /* the former place, of a moved name */
    dev_t dev;           /* the added or removed file */
    ino_t ino;
    char kept[32];       /* name of the removed or replaced file in the folder of kept files; may be empty */
};

struct folder {
    dev_t dev;
    ino_t ino;
    int fd;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static char root[PATH_MAX];
static size_t root_length;
static int keep = -1;
static int kept;
static long points, at;
static int power;
static uint64_t seed, state;
static struct dirty *dirty;
static size_t dirties;
static struct change *changes;
static size_t change_count;
static struct folder *folders;
static size_t folder_count;

static void broken(const char *what) {
    dprintf(2, "power shim: %s: %s\n", what, strerror(errno));
    _exit(99);
}

static void *grown(void *list, size_t count, size_t size) {
    void *more = realloc(list, (count + 1) * size);
    if (!more) broken("memory");
    return more;
}

static uint64_t chance(void) {
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state * 0x2545F4914F6CDD1DULL >> 33;
}

__attribute__((constructor)) static void begin(void) {
    const char *folder = getenv("MAGLINE_SHIM_ROOT");
    if (!folder || strlen(folder) >= sizeof root) return;
    memcpy(root, folder, strlen(folder) + 1);
    char beside[PATH_MAX + 8];
    snprintf(beside, sizeof beside, "%s.kept", root);
    if (syscall(SYS_mkdirat, AT_FDCWD, beside, 0700) && errno != EEXIST) broken(beside);
    keep = syscall(SYS_openat, AT_FDCWD, beside, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (keep < 0) broken(beside);
    const char *text = getenv("MAGLINE_SHIM_AT");
    at = text ? atol(text) : 0;
    text = getenv("MAGLINE_SHIM_MODE");
    power = text && !strcmp(text, "power");
    text = getenv("MAGLINE_SHIM_SEED");
    seed = text ? strtoull(text, 0, 10) : 0;
    state = seed * 0x9E3779B97F4A7C15ULL + 0x1234567;
    root_length = strlen(root);
}

__attribute__((destructor)) static void end(void) {
    const char *count = getenv("MAGLINE_SHIM_COUNT");
    if (!root_length || !count) return;
    char text[32];
    int length = snprintf(text, sizeof text, "%ld\n", points);
    int fd = syscall(SYS_openat, AT_FDCWD, count, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (fd < 0 || syscall(SYS_write, fd, text, length) != length) broken(count);
    syscall(SYS_close, fd);
}

static int below(const char *path) {
    return !strncmp(path, root, root_length) && (path[root_length] == '/' || !path[root_length]);
}

/* Whether an open file is below the root; fills in its status. */
static int watched(int fd, struct stat *about) {
    if (!root_length || fd < 0) return 0;
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = syscall(SYS_readlinkat, AT_FDCWD, link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return below(path) && !fstat(fd, about);
}

/* Descriptor of a folder for the shim; one per folder, open to the end. */
static int folder_fd(const struct stat *about, const char *path) {
    for (size_t i = 0; i < folder_count; i++)
        if (folders[i].dev == about->st_dev && folders[i].ino == about->st_ino) return folders[i].fd;
    int fd = syscall(SYS_openat, AT_FDCWD, path, O_PATH | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) broken(path);
    folders = grown(folders, folder_count, sizeof *folders);
    folders[folder_count++] = (struct folder){about->st_dev, about->st_ino, fd};
    return fd;
}

/* Resolves a path to a folder and a name in it. Returns whether it is below the root. */
static int placed(int dirfd, const char *path, struct place *place) {
    if (!root_length || !path) return 0;
    char whole[PATH_MAX], real[PATH_MAX];
    if (path[0] == '/' || dirfd == AT_FDCWD) {
        if (snprintf(whole, sizeof whole, "%s", path) >= (int)sizeof whole) return 0;
    } else if (snprintf(whole, sizeof whole, "/proc/self/fd/%d/%s", dirfd, path) >= (int)sizeof whole) {
        return 0;
    }
    size_t length = strlen(whole);
    while (length > 1 && whole[length - 1] == '/') whole[--length] = 0;
    char *slash = strrchr(whole, '/');
    const char *name = slash ? slash + 1 : whole;
    if (!*name || strlen(name) > NAME_MAX) return 0;
    strcpy(place->name, name);
    if (slash) *slash = 0;
    const char *above = slash ? (*whole ? whole : "/") : ".";
    struct stat about;
    if (!realpath(above, real) || !below(real) || stat(real, &about)) return 0;
    place->folder = folder_fd(&about, real);
    place->dev = about.st_dev;
    place->ino = about.st_ino;
    return 1;
}

static int is_there(const struct place *place, struct stat *about) {
    return !fstatat(place->folder, place->name, about, AT_SYMLINK_NOFOLLOW);
}

static int is(const struct place *place, dev_t dev, ino_t ino) {
    struct stat about;
    return is_there(place, &about) && about.st_dev == dev && about.st_ino == ino;
}

/* Adds another name to a file that will be removed. */
static void keep_one(const struct place *place, char *name) {
    snprintf(name, 32, "%d", kept++);
    if (syscall(SYS_linkat, place->folder, place->name, keep, name, 0)) *name = 0;
}

static void note(struct change change) {
    changes = grown(changes, change_count, sizeof *changes);
    changes[change_count++] = change;
}

static void undo(const struct change *change) {
    const struct place *to = &change->at;
    char name[32];
    switch (change->kind) {
    case MADE:
        /* A file that was renamed or removed since stays so. A folder is removed with its contents. */
        snprintf(name, sizeof name, "%d", kept++);
        if (is(to, change->dev, change->ino)) syscall(SYS_renameat2, to->folder, to->name, keep, name, 0);
        break;
    case GONE:
        if (*change->kept) syscall(SYS_linkat, keep, change->kept, to->folder, to->name, 0);
        else syscall(SYS_mkdirat, to->folder, to->name, 0755);
        break;
    case MOVED: {
        struct stat about;
        if (!is(to, change->dev, change->ino)) break;
        snprintf(name, sizeof name, "%d", kept++);
        const struct place *from = &change->from;
        if (is_there(from, &about) || syscall(SYS_renameat2, to->folder, to->name, from->folder, from->name, 0))
            syscall(SYS_renameat2, to->folder, to->name, keep, name, 0);
        if (*change->kept) syscall(SYS_linkat, keep, change->kept, to->folder, to->name, 0);
        break;
    }
    }
}

static void cut(int fd, off_t length) {
    if (syscall(SYS_ftruncate, fd, length)) broken("truncate");
}

static void lose(const struct dirty *file) {
    struct stat about;
    if (fstat(file->fd, &about) || about.st_size <= file->synced) return;
    switch (seed ? chance() % 4 : 0) {
    case 0:
        cut(file->fd, file->synced);
        break;
    case 1:
        cut(file->fd, file->synced + (about.st_size - file->synced) / 2);
        break;
    case 2:
        /* The size is on the disk, but not the bytes. */
        cut(file->fd, file->synced);
        cut(file->fd, about.st_size);
        break;
    default:
        break;
    }
}

static void point(void) {
    if (++points != at) return;
    if (power) {
        for (size_t i = 0; i < dirties; i++) lose(&dirty[i]);
        for (size_t i = change_count; i-- > 0;)
            if (!seed || chance() % 2) undo(&changes[i]);
    }
    syscall(SYS_kill, getpid(), SIGKILL);
    for (;;) pause();
}

/* Records that a file will be written to, or truncated to `length`. */
static void touched(int fd, off_t length) {
    struct stat about;
    if (!watched(fd, &about) || !S_ISREG(about.st_mode)) return;
    for (size_t i = 0; i < dirties; i++) {
        if (dirty[i].dev == about.st_dev && dirty[i].ino == about.st_ino) {
            if (length >= 0 && length < dirty[i].synced) dirty[i].synced = length;
            return;
        }
    }
    char path[64];
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    int own = syscall(SYS_openat, AT_FDCWD, path, O_RDWR | O_CLOEXEC);
    if (own < 0) broken(path);
    off_t synced = length >= 0 && length < about.st_size ? length : about.st_size;
    dirty = grown(dirty, dirties, sizeof *dirty);
    dirty[dirties++] = (struct dirty){about.st_dev, about.st_ino, own, synced};
}

static void synced(const struct stat *about) {
    for (size_t i = 0; i < dirties; i++) {
        if (dirty[i].dev == about->st_dev && dirty[i].ino == about->st_ino) {
            syscall(SYS_close, dirty[i].fd);
            dirty[i] = dirty[--dirties];
            break;
        }
    }
    size_t left = 0;
    for (size_t i = 0; i < change_count; i++)
        if (changes[i].at.dev != about->st_dev || changes[i].at.ino != about->st_ino) changes[left++] = changes[i];
    change_count = left;
}

static void came(const struct place *place) {
    struct stat about;
    if (!is_there(place, &about)) return;
    note((struct change){.kind = MADE, .at = *place, .dev = about.st_dev, .ino = about.st_ino});
}

#define ENTER pthread_mutex_lock(&lock)
#define LEAVE(result)                  \
    do {                               \
        long answer = (result);        \
        int error = errno;             \
        pthread_mutex_unlock(&lock);   \
        errno = error;                 \
        return answer;                 \
    } while (0)

static long opened(int dirfd, const char *path, int flags, mode_t mode) {
    struct place place;
    struct stat about;
    int known = (flags & O_CREAT) && placed(dirfd, path, &place);
    int fresh = known && !is_there(&place, &about);
    long fd = syscall(SYS_openat, dirfd, path, flags, mode);
    if (fd < 0) return fd;
    if (fresh) came(&place);
    if ((flags & O_TRUNC) && !fresh) touched(fd, 0);
    return fd;
}

#define MODE                                   \
    mode_t mode = 0;                           \
    if (flags & (O_CREAT | O_TMPFILE)) {       \
        va_list more;                          \
        va_start(more, flags);                 \
        mode = va_arg(more, int);              \
        va_end(more);                          \
    }

int open(const char *path, int flags, ...) {
    MODE
    if (!(flags & (O_CREAT | O_TRUNC))) return syscall(SYS_openat, AT_FDCWD, path, flags, mode);
    ENTER;
    LEAVE(opened(AT_FDCWD, path, flags, mode));
}

int open64(const char *path, int flags, ...) {
    MODE
    if (!(flags & (O_CREAT | O_TRUNC))) return syscall(SYS_openat, AT_FDCWD, path, flags, mode);
    ENTER;
    LEAVE(opened(AT_FDCWD, path, flags, mode));
}

int openat(int dirfd, const char *path, int flags, ...) {
    MODE
    if (!(flags & (O_CREAT | O_TRUNC))) return syscall(SYS_openat, dirfd, path, flags, mode);
    ENTER;
    LEAVE(opened(dirfd, path, flags, mode));
}

int openat64(int dirfd, const char *path, int flags, ...) {
    MODE
    if (!(flags & (O_CREAT | O_TRUNC))) return syscall(SYS_openat, dirfd, path, flags, mode);
    ENTER;
    LEAVE(opened(dirfd, path, flags, mode));
}

int creat(const char *path, mode_t mode) {
    ENTER;
    LEAVE(opened(AT_FDCWD, path, O_CREAT | O_WRONLY | O_TRUNC, mode));
}

int creat64(const char *path, mode_t mode) {
    return creat(path, mode);
}

ssize_t write(int fd, const void *bytes, size_t count) {
    ENTER;
    touched(fd, -1);
    LEAVE(syscall(SYS_write, fd, bytes, count));
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
    ENTER;
    touched(fd, -1);
    LEAVE(syscall(SYS_writev, fd, parts, count));
}

/* Writes over bytes that are on the disk are not recorded; the store has no such writes. */
ssize_t pwrite(int fd, const void *bytes, size_t count, off_t offset) {
    ENTER;
    touched(fd, -1);
    LEAVE(syscall(SYS_pwrite64, fd, bytes, count, offset));
}

ssize_t pwrite64(int fd, const void *bytes, size_t count, off64_t offset) {
    return pwrite(fd, bytes, count, offset);
}

ssize_t copy_file_range(int in, off64_t *from, int out, off64_t *to, size_t count, unsigned flags) {
    ENTER;
    touched(out, -1);
    LEAVE(syscall(SYS_copy_file_range, in, from, out, to, count, flags));
}

ssize_t sendfile64(int out, int in, off64_t *offset, size_t count) {
    ENTER;
    touched(out, -1);
    LEAVE(syscall(SYS_sendfile, out, in, offset, count));
}

int ftruncate(int fd, off_t length) {
    ENTER;
    if (keep >= 0) touched(fd, length);
    LEAVE(syscall(SYS_ftruncate, fd, length));
}

int ftruncate64(int fd, off64_t length) {
    return ftruncate(fd, length);
}

static long sync_one(int fd, long call) {
    struct stat about;
    if (!watched(fd, &about)) return syscall(call, fd);
    point();
    long done = syscall(call, fd);
    if (!done) synced(&about);
    return done;
}

int fsync(int fd) {
    ENTER;
    LEAVE(sync_one(fd, SYS_fsync));
}

int fdatasync(int fd) {
    ENTER;
    LEAVE(sync_one(fd, SYS_fdatasync));
}

static long renamed(int from_fd, const char *from, int to_fd, const char *to, unsigned flags) {
    struct change change = {.kind = MOVED};
    struct stat about, replaced;
    int known = placed(from_fd, from, &change.from) && placed(to_fd, to, &change.at) && is_there(&change.from, &about);
    if (known) {
        if (flags & RENAME_EXCHANGE_FLAG) broken("an exchange of names is not followed");
        point();
        change.dev = about.st_dev;
        change.ino = about.st_ino;
        if (is_there(&change.at, &replaced)) keep_one(&change.at, change.kept);
    }
    long done = syscall(SYS_renameat2, from_fd, from, to_fd, to, flags);
    if (known && !done) note(change);
    return done;
}

int rename(const char *from, const char *to) {
    ENTER;
    LEAVE(renamed(AT_FDCWD, from, AT_FDCWD, to, 0));
}

int renameat(int from_fd, const char *from, int to_fd, const char *to) {
    ENTER;
    LEAVE(renamed(from_fd, from, to_fd, to, 0));
}

int renameat2(int from_fd, const char *from, int to_fd, const char *to, unsigned flags) {
    ENTER;
    LEAVE(renamed(from_fd, from, to_fd, to, flags));
}

static long linked(int from_fd, const char *from, int to_fd, const char *to, int flags) {
    struct place place;
    int known = placed(to_fd, to, &place);
    if (known) point();
    long done = syscall(SYS_linkat, from_fd, from, to_fd, to, flags);
    if (known && !done) came(&place);
    return done;
}

int link(const char *from, const char *to) {
    ENTER;
    LEAVE(linked(AT_FDCWD, from, AT_FDCWD, to, 0));
}

int linkat(int from_fd, const char *from, int to_fd, const char *to, int flags) {
    ENTER;
    LEAVE(linked(from_fd, from, to_fd, to, flags));
}

static long symlinked(const char *target, int fd, const char *path) {
    struct place place;
    int known = placed(fd, path, &place);
    if (known) point();
    long done = syscall(SYS_symlinkat, target, fd, path);
    if (known && !done) came(&place);
    return done;
}

int symlink(const char *target, const char *path) {
    ENTER;
    LEAVE(symlinked(target, AT_FDCWD, path));
}

int symlinkat(const char *target, int fd, const char *path) {
    ENTER;
    LEAVE(symlinked(target, fd, path));
}

static long unlinked(int fd, const char *path, int flags) {
    struct change change = {.kind = GONE};
    struct stat about;
    int known = placed(fd, path, &change.at) && is_there(&change.at, &about);
    if (known && !(flags & AT_REMOVEDIR)) keep_one(&change.at, change.kept);
    long done = syscall(SYS_unlinkat, fd, path, flags);
    if (known && !done) note(change);
    return done;
}

int unlink(const char *path) {
    ENTER;
    LEAVE(unlinked(AT_FDCWD, path, 0));
}

int unlinkat(int fd, const char *path, int flags) {
    ENTER;
    LEAVE(unlinked(fd, path, flags));
}

int rmdir(const char *path) {
    ENTER;
    LEAVE(unlinked(AT_FDCWD, path, AT_REMOVEDIR));
}

static long made(int fd, const char *path, mode_t mode) {
    struct place place;
    int known = placed(fd, path, &place);
    long done = syscall(SYS_mkdirat, fd, path, mode);
    if (known && !done) came(&place);
    return done;
}

int mkdir(const char *path, mode_t mode) {
    ENTER;
    LEAVE(made(AT_FDCWD, path, mode));
}

int mkdirat(int fd, const char *path, mode_t mode) {
    ENTER;
    LEAVE(made(fd, path, mode));
}
