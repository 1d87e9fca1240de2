// Evaluates view-dependent colour: real spherical harmonics up to degree SH_DEGREE, in the basis and the sign convention
// of 3D Gaussian Splatting. The coefficients are in planes of four floats per splat; float 3 k + c of a splat is channel c
// of coefficient k, so four coefficients fill three planes. Half floats and 8-bit coefficients have all planes in one buffer, one
// after the other (see pack_sh.comp). Packed splats have them in their records. With LONG_SH, four half floats are loaded as a
// 64-bit word.
//
// Source of the basis: Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2013; signs as in Kerbl et al. 2023.

#include "sh_layout.glsl"

#if STORAGE != STORAGE_SEPARATE
#include "unpack_splat.glsl"
#elif SH_STORAGE == SH_STORAGE_F16
#ifdef LONG_SH
layout(set = 0, binding = 8, std430) readonly buffer Sh { uint64_t sh[]; };
#define sh_halves(at) unpackUint2x32(sh[at])
#else
layout(set = 0, binding = 8, std430) readonly buffer Sh { uvec2 sh[]; };
#define sh_halves(at) sh[at]
#endif

vec4 sh_plane(uint plane, uint i) {
    uvec2 halves = sh_halves(plane * uint(SCENE_COUNT) + i);
    return vec4(unpackHalf2x16(halves.x), unpackHalf2x16(halves.y));
}
#elif SH_STORAGE == SH_STORAGE_Q8
layout(set = 0, binding = 8, std430) readonly buffer Sh { uvec2 sh[]; };

// Returns the constant coefficients and the scale of the others.
vec4 sh_head(uint i) {
    uvec2 halves = sh[i];
    return vec4(unpackHalf2x16(halves.x), unpackHalf2x16(halves.y));
}

// Returns floats 4 w + 3 to 4 w + 6, as shares of the scale; 0 beyond the last.
vec4 sh_word(uint w, uint i) {
    return w < uint(SH_WORDS) ? unpackSnorm4x8(sh[(1u + w / 2u) * uint(SCENE_COUNT) + i][w & 1u]) : vec4(0.0);
}

vec4 sh_plane(uint plane, uint i) {
    vec4 head = sh_head(i);
    float next = head.w * sh_word(plane, i).x;
    return plane == 0u ? vec4(head.xyz, next) : vec4(head.w * sh_word(plane - 1u, i).yzw, next);
}
#else
layout(set = 0, binding = 8, std430) readonly buffer Sh { vec4 v[]; } sh[SH_PLANES];

#define sh_plane(plane, i) sh[plane].v[i]
#endif

// Evaluates the colour of splat `i` along `d`, a unit vector from the camera to the splat. At least 0, without a maximum.
vec3 sh_colour(uint i, vec3 d) {
#if STORAGE != STORAGE_SEPARATE
    read_harmonics(i);
#endif
    vec4 a = sh_plane(0u, i);
    vec3 colour = 0.28209479177387814 * a.xyz;
#if SH_DEGREE >= 1
    float x = d.x, y = d.y, z = d.z;
    vec4 b = sh_plane(1u, i);
    vec4 c = sh_plane(2u, i);
    const float C1 = 0.4886025119029199;
    colour += C1 * (z * vec3(b.zw, c.x) - y * vec3(a.w, b.xy) - x * c.yzw);
#endif
#if SH_DEGREE >= 2
    float xx = x * x, yy = y * y, zz = z * z;
    a = sh_plane(3u, i);
    b = sh_plane(4u, i);
    c = sh_plane(5u, i);
    colour += 1.0925484305920792 * (x * y) * a.xyz
        - 1.0925484305920792 * (y * z) * vec3(a.w, b.xy)
        + 0.31539156525252005 * (2.0 * zz - xx - yy) * vec3(b.zw, c.x)
        - 1.0925484305920792 * (x * z) * c.yzw;
    a = sh_plane(6u, i);
    colour += 0.5462742152960396 * (xx - yy) * a.xyz;
#endif
#if SH_DEGREE >= 3
    b = sh_plane(7u, i);
    c = sh_plane(8u, i);
    colour += -0.5900435899266435 * (y * (3.0 * xx - yy)) * vec3(a.w, b.xy)
        + 2.890611442640554 * (x * y * z) * vec3(b.zw, c.x)
        - 0.4570457994644658 * (y * (4.0 * zz - xx - yy)) * c.yzw;
    a = sh_plane(9u, i);
    b = sh_plane(10u, i);
    c = sh_plane(11u, i);
    colour += 0.3731763325901154 * (z * (2.0 * zz - 3.0 * xx - 3.0 * yy)) * a.xyz
        - 0.4570457994644658 * (x * (4.0 * zz - xx - yy)) * vec3(a.w, b.xy)
        + 1.445305721320277 * (z * (xx - yy)) * vec3(b.zw, c.x)
        - 0.5900435899266435 * (x * (xx - 3.0 * yy)) * c.yzw;
#endif
    return max(colour + 0.5, vec3(0.0));
}
