#version 460
#extension GL_GOOGLE_include_directive : require

// Rounds the coefficients of spherical harmonics to half floats, once per scene. Each invocation takes one splat.

#include "groups.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Sh { vec4 v[]; } sh[SH_PLANES];
layout(set = 0, binding = SH_PLANES, std430) writeonly buffer ShHalf { uvec2 sh_half[]; };

// The largest half float. Conversion of more is not defined.
const float LARGEST = 65504.0;

void store(uint plane, uint i, vec4 v) {
    v = clamp(v, -LARGEST, LARGEST);
    sh_half[plane * uint(SCENE_COUNT) + i] = uvec2(packHalf2x16(v.xy), packHalf2x16(v.zw));
}

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i >= uint(SCENE_COUNT)) {
        return;
    }
    // One line for each plane: not every device takes variable indices into arrays of buffers.
    store(0u, i, sh[0].v[i]);
#if SH_PLANES > 1
    store(1u, i, sh[1].v[i]);
    store(2u, i, sh[2].v[i]);
#endif
#if SH_PLANES > 3
    store(3u, i, sh[3].v[i]);
    store(4u, i, sh[4].v[i]);
    store(5u, i, sh[5].v[i]);
    store(6u, i, sh[6].v[i]);
#endif
#if SH_PLANES > 7
    store(7u, i, sh[7].v[i]);
    store(8u, i, sh[8].v[i]);
    store(9u, i, sh[9].v[i]);
    store(10u, i, sh[10].v[i]);
    store(11u, i, sh[11].v[i]);
#endif
}
