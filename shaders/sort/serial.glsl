// The shape of the serial sort: a block is one invocation's, which walks it alone. It needs no shared memory, no barrier
// and no subgroup operation, and so suits devices with narrow subgroups, above all those that compute on the CPU: there
// the cache is the shared memory, and talking to another lane costs more than the work.

#include "digit.glsl"

layout(local_size_x = DEVICE_SUBGROUP_SIZE) in;

uint invocation_index() {
    return group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
}
