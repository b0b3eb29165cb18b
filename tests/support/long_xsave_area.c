/*
 * A wrapper of ptrace for tests. It emulates the host's kernel on a processor whose XSAVE area is longer than the
 * buffer of user-mode Linux, as with AMX: the area is the true one followed by 8,192 bytes with a pattern, as long
 * as the tiles of AMX. It is shortened when it is read, and must be whole and keep the pattern when it is written.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

#define TILE_BYTES 8192
#define PATTERN 0x5a

typedef long ptrace_function(int request, int pid, void *address, void *data);

static ptrace_function *next_ptrace;
static unsigned char area[65536];

__attribute__((constructor)) static void find_next_ptrace(void)
{
    next_ptrace = (ptrace_function *)dlsym(RTLD_NEXT, "ptrace");
}

static int is_whole(const struct iovec *callers, size_t true_length)
{
    const unsigned char *bytes = callers->iov_base;
    if (callers->iov_len < true_length + TILE_BYTES)
        return 0;
    for (size_t i = true_length; i < true_length + TILE_BYTES; i++)
        if (bytes[i] != PATTERN)
            return 0;
    return 1;
}

static long transfer_long_area(int request, int pid, void *address, struct iovec *callers)
{
    struct iovec true_area = {area, sizeof area - TILE_BYTES};
    if (next_ptrace(PTRACE_GETREGSET, pid, address, &true_area) < 0)
        return -1;
    if (request == PTRACE_GETREGSET) {
        size_t length = true_area.iov_len + TILE_BYTES;
        memset(area + true_area.iov_len, PATTERN, TILE_BYTES);
        if (callers->iov_len > length)
            callers->iov_len = length;
        memcpy(callers->iov_base, area, callers->iov_len);
        return 0;
    }
    if (!is_whole(callers, true_area.iov_len)) {
        errno = EFAULT;
        return -1;
    }
    struct iovec beginning = {callers->iov_base, true_area.iov_len};
    return next_ptrace(PTRACE_SETREGSET, pid, address, &beginning);
}

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    int pid = va_arg(arguments, int);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if ((request == PTRACE_GETREGSET || request == PTRACE_SETREGSET) && (size_t)address == NT_X86_XSTATE)
        return transfer_long_area(request, pid, address, data);
    return next_ptrace(request, pid, address, data);
}
