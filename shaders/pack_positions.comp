#version 460
#extension GL_GOOGLE_include_directive : require

// Rounds positions to 16 bits per axis, within the bounding box of their block of 256 splats, once per scene. A workgroup
// takes a block; packed_position.glsl has the layout.

#include "groups.glsl"
#include "ordered_floats.glsl"
#include "packed_position.glsl"

layout(local_size_x = 256) in;

struct Position3 { float x, y, z; };

layout(set = 0, binding = 0, std430) readonly buffer Position { Position3 position[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Packed { uint packed_words[]; };

// The corners of the box, as integers in the order of the floats.
shared uint least[3];
shared uint most[3];
shared uint steps[3 * 256];

void main() {
    uint block = group_index();
    uint thread = gl_LocalInvocationIndex;
    uint i = block * 256u + thread;
    if (thread < 3u) {
        least[thread] = 0xffffffffu;
        most[thread] = 0u;
    }
    barrier();
    float p[3] = float[3](0.0, 0.0, 0.0);
    if (i < uint(SCENE_COUNT)) {
        p = float[3](position[i].x, position[i].y, position[i].z);
        for (uint axis = 0u; axis < 3u; axis++) {
            atomicMin(least[axis], in_order(p[axis]));
            atomicMax(most[axis], in_order(p[axis]));
        }
    }
    barrier();
    for (uint axis = 0u; axis < 3u; axis++) {
        float low = from_order(least[axis]);
        float high = from_order(most[axis]);
        // Halved, so that no difference overflows.
        float side = 0.5 * high - 0.5 * low;
        float share = side > 0.0 ? clamp((0.5 * p[axis] - 0.5 * low) / side, 0.0, 1.0) : 0.0;
        steps[3u * thread + axis] = uint(share * 65535.0 + 0.5);
    }
    barrier();
    uint first = block * BLOCK_WORDS;
    if (first >= uint(BLOCK_COUNT) * BLOCK_WORDS) {
        return;
    }
    for (uint word = thread; word < STEP_WORDS; word += 256u) {
        packed_words[first + word] = steps[2u * word] | (steps[2u * word + 1u] << 16);
    }
    if (thread < 3u) {
        packed_words[first + STEP_WORDS + thread] = floatBitsToUint(from_order(least[thread]));
        packed_words[first + STEP_WORDS + 3u + thread] = floatBitsToUint(from_order(most[thread]));
    }
}
