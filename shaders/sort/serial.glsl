// The shape of the serial sort: one block per invocation. It needs no shared memory, no barrier and no subgroup operation,
// so it suits devices with narrow subgroups, above all CPUs: there, the cache replaces shared memory, and communication
// between lanes costs more than the work.

#include "blocks.glsl"
#include "digit.glsl"

layout(local_size_x = DEVICE_SUBGROUP_SIZE) in;

uint invocation_index() {
    return group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
}
