// Runs a kernel on the CPU with Metal's semantics: threadgroups one after another, each thread as a fiber with its own stack. A thread
// runs until it reaches a SIMD-group operation or a threadgroup barrier, and resumes once all participants have reached it. Nothing
// else orders the threads of a SIMD-group, so a kernel that relies on lockstep fails.
//
// The test can reverse the order of threadgroups, SIMD-groups and lanes, and the assignment of threads to SIMD-groups. A result that
// depends on them is a race.
#include <metal_stdlib>

#undef kernel
#undef thread
#undef constant
#undef device

#include <setjmp.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <ucontext.h>
#include <unistd.h>

namespace {

using metal::Call;
using metal::Lanes;

const unsigned MOST_THREADS = 1024, STACK = 256 << 10, MOST_LANES = 64;

enum State { READY, AT_OPERATION, AT_BARRIER, DONE };

struct Fiber {
    jmp_buf place;
    ucontext_t start;
    bool started;
    State state;
    // Line of the operation or barrier at which it waits, and number of operations that it has reached in this threadgroup.
    unsigned line, operations;
    Call call;
};

struct Machine {
    Fiber fibers[MOST_THREADS];
    // Operand of each thread. A thread may reach the next operation before another has read, so two sets alternate.
    unsigned char values[2][MOST_THREADS][16];
    unsigned long active[MOST_THREADS];
    void (*kernel)(const Call&);
    const char* name;
    unsigned lanes, threads;
    Fiber* running;
    jmp_buf scheduler;
    ucontext_t unused;
    char error[256];
};

thread_local Machine* machine = nullptr;

// Returns to the scheduler until the thread may resume.
__attribute__((noinline)) void pause_as(State state, unsigned line) {
    Fiber& fiber = *machine->running;
    fiber.state = state;
    fiber.line = line;
    if (!_setjmp(fiber.place)) _longjmp(machine->scheduler, 1);
}

// Body of a fiber: runs the kernel for one threadgroup after another.
void live() {
    for (;;) {
        machine->kernel(machine->running->call);
        pause_as(DONE, 0);
    }
}

__attribute__((noinline)) void go_on(Fiber& fiber) {
    machine->running = &fiber;
    if (_setjmp(machine->scheduler)) return;
    if (fiber.started) _longjmp(fiber.place, 1);
    fiber.started = true;
    setcontext(&fiber.start);
}

bool fail(const char* what, unsigned line, unsigned other) {
    snprintf(machine->error, sizeof machine->error, "%s: %s (lines %u and %u)", machine->name, what, line, other);
    return false;
}

// Runs a SIMD-group until each of its threads is at a barrier or done. Returns false on an error.
bool run_simdgroup(unsigned first, unsigned end, bool reversed) {
    for (;;) {
        unsigned long active = 0;
        const Fiber *leader = nullptr, *elsewhere = nullptr;
        for (unsigned i = 0; i < end - first; i++) {
            unsigned lane = reversed ? end - first - 1 - i : i;
            Fiber& fiber = machine->fibers[first + lane];
            if (fiber.state == READY) go_on(fiber);
            if (fiber.state == AT_BARRIER) elsewhere = &fiber;
            if (fiber.state != AT_OPERATION) continue;
            if (!leader) leader = &fiber;
            if (fiber.line != leader->line || fiber.operations != leader->operations) elsewhere = &fiber;
            active |= 1ul << lane;
        }
        if (!leader) return true;
        // The shipped kernels use operations in uniform control flow only. Anything else is reported as an error.
        if (elsewhere) return fail("lanes of a SIMD-group are at different operations", leader->line, elsewhere->line);
        for (unsigned i = first; i < end; i++) {
            Fiber& fiber = machine->fibers[i];
            if (fiber.state != AT_OPERATION) continue;
            machine->active[i] = active;
            fiber.state = READY;
        }
    }
}

bool run_threadgroup(bool reversed) {
    Machine& m = *machine;
    for (unsigned i = 0; i < m.threads; i++) {
        m.fibers[i].state = READY;
        m.fibers[i].operations = 0;
    }
    unsigned groups = (m.threads + m.lanes - 1) / m.lanes;
    for (;;) {
        for (unsigned i = 0; i < groups; i++) {
            unsigned first = (reversed ? groups - 1 - i : i) * m.lanes;
            unsigned end = first + m.lanes < m.threads ? first + m.lanes : m.threads;
            if (!run_simdgroup(first, end, reversed)) return false;
        }
        const Fiber *waits = nullptr, *done = nullptr;
        for (unsigned i = 0; i < m.threads; i++) {
            Fiber& fiber = m.fibers[i];
            if (fiber.state == DONE) done = &fiber;
            if (fiber.state != AT_BARRIER) continue;
            if (waits && fiber.line != waits->line) return fail("threads are at different barriers", waits->line, fiber.line);
            waits = &fiber;
        }
        if (!waits) return true;
        if (done) return fail("some threads do not come to a barrier", waits->line, 0);
        for (unsigned i = 0; i < m.threads; i++) m.fibers[i].state = READY;
    }
}

// Reports an access to the inaccessible page behind a buffer, and ends the process.
void out_of_bounds(int, siginfo_t* info, void*) {
    char text[256];
    int length = snprintf(text, sizeof text, "%s: an access beyond the end of a buffer, at %p\n", machine ? machine->name : "?", info->si_addr);
    if (write(2, text, length)) {}
    _exit(3);
}

Machine* make() {
    Machine* made = static_cast<Machine*>(calloc(1, sizeof(Machine)));
    void* stacks = mmap(nullptr, size_t(MOST_THREADS) * STACK, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (!made || stacks == MAP_FAILED) abort();
    for (unsigned i = 0; i < MOST_THREADS; i++) {
        Fiber& fiber = made->fibers[i];
        getcontext(&fiber.start);
        fiber.start.uc_stack.ss_sp = static_cast<char*>(stacks) + size_t(i) * STACK;
        fiber.start.uc_stack.ss_size = STACK;
        fiber.start.uc_link = &made->unused;
        makecontext(&fiber.start, live, 0);
    }
    struct sigaction action = {};
    action.sa_sigaction = out_of_bounds;
    action.sa_flags = SA_SIGINFO;
    sigaction(SIGSEGV, &action, nullptr);
    return made;
}

metal::uint3 place_in(metal::uint3 box, unsigned i) { return {i % box.x, i / box.x % box.y, i / box.x / box.y}; }

}

extern "C" Lanes machine_exchange(const void* value, unsigned bytes, unsigned line) {
    unsigned self = unsigned(machine->running - machine->fibers), first = self - self % machine->lanes;
    unsigned operation = machine->fibers[self].operations++;
    unsigned char(*values)[16] = machine->values[operation % 2];
    if (bytes) memcpy(values[self], value, bytes);
    pause_as(AT_OPERATION, line);
    return Lanes{values + first, machine->active[self], self - first};
}

extern "C" void machine_barrier(unsigned line) { pause_as(AT_BARRIER, line); }

// Runs `groups` threadgroups of `size` threads with SIMD-groups of `lanes`. Returns an error message, or null.
extern "C" const char* machine_run(void (*kernel)(const Call&), const char* name, void** buffers, metal::Image* images,
                                   const unsigned* groups, const unsigned* size, unsigned lanes, bool reversed) {
    if (!machine) machine = make();
    Machine& m = *machine;
    m.kernel = kernel;
    m.name = name;
    m.lanes = lanes;
    m.threads = size[0] * size[1] * size[2];
    if (m.threads > MOST_THREADS || lanes > MOST_LANES) return "more threads or lanes than the machine has";
    unsigned all = groups[0] * groups[1] * groups[2];
    metal::uint3 threads = {size[0], size[1], size[2]}, count = {groups[0], groups[1], groups[2]};
    for (unsigned i = 0; i < all; i++) {
        metal::uint3 group = place_in(count, reversed ? all - 1 - i : i);
        for (unsigned t = 0; t < m.threads; t++) {
            // Metal does not specify which threads form a SIMD-group.
            unsigned index = reversed ? m.threads - 1 - t : t;
            metal::uint3 within = place_in(threads, index);
            m.fibers[t].call = Call{buffers, images, group, count, group * threads + within, index, t % lanes, t / lanes};
        }
        if (!run_threadgroup(reversed)) {
            machine = nullptr; // Its fibers stopped inside the kernel and cannot be reused.
            return m.error;
        }
    }
    return nullptr;
}
