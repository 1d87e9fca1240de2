// The shape of a workgroup that takes a block together: its subgroups have a stretch of the block each, in which their lanes
// stand side by side. Memory order is (subgroup, step, lane), and that is the order of the sort's ties.
//
// Eight subgroups, or as many of these as 256 invocations and 16 KiB of shared memory allow: see scatter.comp.

#include "digit.glsl"

const uint LANES = uint(DEVICE_SUBGROUP_SIZE);
#if DEVICE_SUBGROUP_SIZE <= 32 && DIGIT_BITS <= 9
#define BLOCK_SUBGROUPS 8
#elif DEVICE_SUBGROUP_SIZE <= 64
#define BLOCK_SUBGROUPS 4
#else
#define BLOCK_SUBGROUPS 2
#endif
const uint SUBGROUPS = uint(BLOCK_SUBGROUPS);
const uint THREADS = SUBGROUPS * LANES;
// Steps that a lane makes through its subgroup's stretch. Known to the compiler, so that keys stay in registers.
const uint STEPS = (uint(BLOCK_KEYS) + THREADS - 1u) / THREADS;

layout(local_size_x = BLOCK_SUBGROUPS * DEVICE_SUBGROUP_SIZE) in;

// Vulkan does not say how invocations are laid over subgroups, so indices are made from these two only.
uint thread_index() {
    return gl_SubgroupID * LANES + gl_SubgroupInvocationID;
}
