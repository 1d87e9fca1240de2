// Scans over a workgroup of THREADS invocations, a constant that the including file defines.

const uint SUBGROUPS = THREADS / uint(DEVICE_SUBGROUP_SIZE);

#include "../workgroup_sum.glsl"

// Vulkan does not define the mapping of invocations to subgroups, so indices come from these two values only.
uint thread_index() {
    return gl_SubgroupID * uint(DEVICE_SUBGROUP_SIZE) + gl_SubgroupInvocationID;
}
