/*
 * A wrapper of ptrace, preloaded into user-mode Linux (linux.uml) so that it starts on every x86-64 processor.
 *
 * Why. User-mode Linux 6.1 keeps the floating-point registers of each of its processes in a buffer of 2,696
 * bytes. It reads and writes them with ptrace as the register set NT_X86_XSTATE, whose content is the processor's
 * XSAVE area. On a processor with AMX that area has 11,008 bytes. When it is read, the host's kernel shortens it
 * to the buffer. When it is written, the host's kernel accepts only the whole area and answers EFAULT otherwise
 * (xstateregs_set in arch/x86/kernel/fpu/regset.c). User-mode Linux then stops at its first process with the
 * message "ptrace set fp regs failed, errno = 14". Later kernels size the buffer by the host.
 *
 * What. Before an area is written, the process's present area is read whole. The caller's bytes replace its
 * beginning, and the whole area is written. The rest keeps its present value. It holds AMX tiles. A program may
 * use those only after arch_prctl(ARCH_REQ_XCOMP_PERM), and user-mode Linux refuses that call.
 *
 * Every other request goes unchanged to the C library's ptrace, which also implements the PEEK requests.
 *
 * It is used on every machine, also where the area fits, so that every test run exercises it.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

#define MAX_AREA_BYTES 65536 /* the kernel reads no more than the host's area */

typedef long ptrace_function(int request, int pid, void *address, void *data);

static ptrace_function *next_ptrace;

__attribute__((constructor)) static void find_next_ptrace(void)
{
    next_ptrace = (ptrace_function *)dlsym(RTLD_NEXT, "ptrace");
}

static long write_whole_area(int pid, void *address, struct iovec *callers)
{
    /* Not on the stack: user-mode Linux calls this on kernel stacks of 16 KiB. */
    static _Thread_local unsigned char area[MAX_AREA_BYTES];
    struct iovec whole = {area, sizeof area};

    if (next_ptrace(PTRACE_GETREGSET, pid, address, &whole) < 0)
        return -1;
    if (callers->iov_len > whole.iov_len)
        callers->iov_len = whole.iov_len; /* as the kernel does */
    memcpy(area, callers->iov_base, callers->iov_len);
    return next_ptrace(PTRACE_SETREGSET, pid, address, &whole);
}

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    int pid = va_arg(arguments, int);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if (request == PTRACE_SETREGSET && (size_t)address == NT_X86_XSTATE)
        return write_whole_area(pid, address, data);
    return next_ptrace(request, pid, address, data);
}
