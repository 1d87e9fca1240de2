#version 460
#extension GL_GOOGLE_include_directive : require

// Rounds the coefficients of spherical harmonics, once per scene. Each invocation takes one splat.
//
// `f16` has the planes of four floats in half floats. `q8` has a plane with the three constant coefficients and a scale in half
// floats, followed by planes of eight bytes: each other coefficient as a share of the scale, the largest of them, in steps of
// 1/127. This rounds a coefficient by at most 1/254 of the splat's largest one.

#include "groups.glsl"
#include "sh_planes.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = SH_PLANES, std430) writeonly buffer Packed { uvec2 packed_sh[]; };

// The largest half float. Converting a larger value is undefined.
const float LARGEST = 65504.0;

#if SH_STORAGE == SH_STORAGE_F16
void store(uint i) {
    for (uint plane = 0u; plane < uint(SH_PLANES); plane++) {
        vec4 v = clamp(planes[plane], -LARGEST, LARGEST);
        packed_sh[plane * uint(SCENE_COUNT) + i] = uvec2(packHalf2x16(v.xy), packHalf2x16(v.zw));
    }
}
#else
float largest(vec4 v) {
    v = abs(v);
    return max(max(v.x, v.y), max(v.z, v.w));
}

// Packs the four coefficients from float 4 `word` + 3 on, divided by `scale`; 0 beyond the last.
uint bytes_of(uint word, float scale) {
    vec4 v = vec4(0.0);
    if (word < uint(SH_WORDS)) {
        v.x = planes[word].w;
        v.yzw = word + 1u < uint(SH_PLANES) ? planes[word + 1u].xyz : vec3(0.0);
    }
    return packSnorm4x8(v / scale);
}

void store(uint i) {
#if SH_DEGREE == 0 || SH_DEGREE == 2
    // This float belongs to the next band, or to no coefficient.
    planes[SH_PLANES - 1].w = 0.0;
#endif
    float most = abs(planes[0].w);
    for (uint plane = 1u; plane < uint(SH_PLANES); plane++) {
        most = max(most, largest(planes[plane]));
    }
    vec3 constant = clamp(planes[0].xyz, -LARGEST, LARGEST);
    uvec2 head = uvec2(packHalf2x16(constant.xy), packHalf2x16(vec2(constant.z, min(most, LARGEST))));
    packed_sh[i] = head;
    // The scale as it is read back, rounded to a half float. If it is 0, all coefficients are stored as 0.
    float scale = unpackHalf2x16(head.y).y;
    for (uint word = 0u; word < uint(SH_WORDS); word += 2u) {
        uvec2 bytes = scale > 0.0 ? uvec2(bytes_of(word, scale), bytes_of(word + 1u, scale)) : uvec2(0u);
        packed_sh[(1u + word / 2u) * uint(SCENE_COUNT) + i] = bytes;
    }
}
#endif

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i >= uint(SCENE_COUNT)) {
        return;
    }
    load_planes(i);
    store(i);
}
