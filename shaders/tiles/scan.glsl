// Scans over a workgroup of 256 invocations.

layout(local_size_x = 256) in;

const uint THREADS = 256u;
const uint SUBGROUPS = THREADS / uint(DEVICE_SUBGROUP_SIZE);

#include "../workgroup_sum.glsl"

// Vulkan does not define the mapping of invocations to subgroups, so indices come from these two values only.
uint thread_index() {
    return gl_SubgroupID * uint(DEVICE_SUBGROUP_SIZE) + gl_SubgroupInvocationID;
}
