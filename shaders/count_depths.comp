#version 460
#extension GL_GOOGLE_include_directive : require

// Counts the visible splats in each depth class. A workgroup counts 4,096 splats in shared memory, and adds its counts to the totals;
// integer sums do not depend on the order.

#include "camera.glsl"
#include "depth_classes.glsl"
#include "groups.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Depth { float depth[]; };
layout(set = 0, binding = 1, std430) buffer Classes { uint classes[]; };

const uint THREADS = 256u;
const uint PER_THREAD = 16u;

shared uint counts[CLASSES];

void main() {
    uint thread = gl_LocalInvocationIndex;
    for (uint c = thread; c < CLASSES; c += THREADS) {
        counts[c] = 0u;
    }
    barrier();
    uint first = group_index() * (THREADS * PER_THREAD) + thread;
    for (uint j = 0u; j < PER_THREAD; j++) {
        uint i = first + j * THREADS;
        float z = i < uint(SCENE_COUNT) ? depth[i] : -1.0;
        if (z > 0.0) {
            atomicAdd(counts[depth_place(z) >> (32u - CLASS_BITS)], 1u);
        }
    }
    barrier();
    for (uint c = thread; c < CLASSES; c += THREADS) {
        if (counts[c] != 0u) {
            atomicAdd(classes[c], counts[c]);
        }
    }
}
