// The spherical harmonics of a splat, in planes of four floats.

#include "sh_layout.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Sh { vec4 v[]; } sh[SH_PLANES];

vec4 planes[SH_PLANES];

void load_planes(uint i) {
    // One line per plane: not every device allows variable indices into arrays of buffers.
    planes[0] = sh[0].v[i];
#if SH_PLANES > 1
    planes[1] = sh[1].v[i];
    planes[2] = sh[2].v[i];
#endif
#if SH_PLANES > 3
    planes[3] = sh[3].v[i];
    planes[4] = sh[4].v[i];
    planes[5] = sh[5].v[i];
    planes[6] = sh[6].v[i];
#endif
#if SH_PLANES > 7
    planes[7] = sh[7].v[i];
    planes[8] = sh[8].v[i];
    planes[9] = sh[9].v[i];
    planes[10] = sh[10].v[i];
    planes[11] = sh[11].v[i];
#endif
}
