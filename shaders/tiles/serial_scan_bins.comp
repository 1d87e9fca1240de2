#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Fifth pass of binning, serial: places the bins' lists one after the other, in one workgroup. Each invocation takes a range of
// bins. The lists may need more entries than the buffer holds.

#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Lengths { uint lengths[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Ranges { uvec2 ranges[]; };

void main() {
    const uint RANGE = (uint(BIN_COUNT) + gl_WorkGroupSize.x - 1u) / gl_WorkGroupSize.x;
    uint first = gl_SubgroupInvocationID * RANGE;
    uint end = min(first + RANGE, uint(BIN_COUNT));
    uint sum = 0u;
    for (uint bin = first; bin < end; bin++) {
        sum += lengths[bin];
    }
    uint start = subgroupExclusiveAdd(sum);
    for (uint bin = first; bin < end; bin++) {
        uint end = start + lengths[bin];
        ranges[bin] = uvec2(start, end);
        start = end;
    }
}
