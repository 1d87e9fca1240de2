#version 460
#extension GL_GOOGLE_include_directive : require

// Checks that pairs are sorted as by a stable sort, and counts the wrong ones.
//
// Pair i is right if its value is an index, its key belongs to this value, and pair i - 1 is less, by key and then by value. If all
// pairs are right, they are all different, so that none was lost, and their order is the only stable one.

#include "../groups.glsl"
#include "pairs_key.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 1, std430) readonly buffer Values { uint values[]; };
layout(set = 0, binding = 2, std430) buffer Wrong { uint wrong; };
layout(set = 0, binding = 3, rgba32f) writeonly uniform image2D result;

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i >= uint(PAIRS)) {
        return;
    }
    uint key = keys[i], value = values[i];
    bool right = value < uint(PAIRS) && key == key_of(value);
    if (i > 0u) {
        uint former = keys[i - 1u];
        right = right && (former < key || former == key && values[i - 1u] < value);
    } else {
        // Every graph has an output image.
        imageStore(result, ivec2(0), vec4(float(key), float(value), 0.0, 1.0));
    }
    if (!right) {
        atomicAdd(wrong, 1u);
    }
}
