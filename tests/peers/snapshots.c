/* Preloaded, keeps a copy of an HDF5 file as it is after each write to it: what a kill at that moment would leave.
   SNAPSHOTS: the folder, one file a write. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <unistd.h>

static void copy(int fd) {
    static int n;
    char link[64], path[512], name[600];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    const char *folder = getenv("SNAPSHOTS");
    if (!folder || length < 3) return;
    path[length] = 0;
    if (strcmp(path + length - 3, ".h5")) return;
    snprintf(name, sizeof name, "%s/%05d.h5", folder, n++);
    int from = open(path, O_RDONLY), to = open(name, O_CREAT | O_WRONLY, 0666);
    struct stat status;
    off_t done = 0;
    fstat(from, &status);
    while (done < status.st_size && sendfile(to, from, &done, (size_t)(status.st_size - done)) > 0) continue;
    close(from);
    close(to);
}

ssize_t pwrite64(int fd, const void *bytes, size_t n, off_t place) {
    ssize_t (*next)(int, const void *, size_t, off_t) = dlsym(RTLD_NEXT, "pwrite64");
    ssize_t written = next(fd, bytes, n, place);
    copy(fd);
    return written;
}

ssize_t pwrite(int fd, const void *bytes, size_t n, off_t place) { return pwrite64(fd, bytes, n, place); }

ssize_t write(int fd, const void *bytes, size_t n) {
    ssize_t (*next)(int, const void *, size_t) = dlsym(RTLD_NEXT, "write");
    ssize_t written = next(fd, bytes, n);
    copy(fd);
    return written;
}

int ftruncate64(int fd, off_t length) {
    int (*next)(int, off_t) = dlsym(RTLD_NEXT, "ftruncate64");
    int status = next(fd, length);
    copy(fd);
    return status;
}

int ftruncate(int fd, off_t length) { return ftruncate64(fd, length); }
