// Independent invocations of the serial passes: see serial.glsl.

#include "../groups.glsl"

layout(local_size_x = DEVICE_SUBGROUP_SIZE) in;

uint invocation_index() {
    return group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
}
