#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Assigns keys to the depth classes in proportion to their splats: the first key of a class is the share of the splats before
// it. An exclusive scan by one workgroup; word CLASSES is the end of the last class.

#include "camera.glsl"
#include "depth_classes.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Classes { uint classes[]; };
layout(set = 0, binding = 1, std430) writeonly buffer KeyStarts { uint key_starts[]; };

const uint THREADS = 256u;
const uint PER_THREAD = CLASSES / THREADS;
const uint SUBGROUPS = THREADS / uint(DEVICE_SUBGROUP_SIZE);

#include "thread_index.glsl"
#include "workgroup_sum.glsl"

// Returns the key before which `count` of `all` splats come. Like `stretch` of depth_key.glsl: the factor is rounded, but it is the
// same for every class. A width of 32 bits counts as 31, so that `1u << bits` is defined.
uint key_after(uint count, uint all) {
    if (all == 0u) {
        return 0u;
    }
    uint bits = min(uint(KEY_BITS), 31u);
    uint up = 31u - uint(findMSB(all));
    float factor = exp2(float(bits)) * (4294967296.0 / (float(all << up) + 1.0));
    uint key, low;
    umulExtended(count << up, uint(min(factor, 4294967040.0)), key, low);
    return min(key, (1u << bits) - 1u);
}

void main() {
    uint thread = thread_index();
    uint count[PER_THREAD];
    uint sum = 0u;
    for (uint j = 0u; j < PER_THREAD; j++) {
        count[j] = classes[thread * PER_THREAD + j];
        sum += count[j];
    }
    uint all = 0u;
    uint before = exclusive_sum(sum, 0u, all);
    for (uint j = 0u; j < PER_THREAD; j++) {
        key_starts[thread * PER_THREAD + j] = key_after(before, all);
        before += count[j];
    }
    if (thread == THREADS - 1u) {
        key_starts[CLASSES] = key_after(all, all);
    }
}
