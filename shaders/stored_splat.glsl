// Reads a splat's position, opacity and covariance as they are stored: in buffers of their own, or packed.

#if STORAGE != STORAGE_SEPARATE
#define FIXED_POSITIONS
#elif POSITION_STORAGE == POSITION_STORAGE_FIXED16
#define FIXED_POSITIONS
#elif SCENE_WIDE
// The rounded position, and the rest to add: some files exceed the precision of floats.
struct Position3 { float x, y, z, low_x, low_y, low_z; };
#define HAS_LOW
#else
struct Position3 { float x, y, z; };
#endif

#ifdef FIXED_POSITIONS
#include "packed_position.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Position { uint position[]; };

vec3 position_of(uint i) {
    uint first = (i >> 8) * BLOCK_WORDS;
    uint at = 3u * (i & 255u);
    uint a = position[first + (at >> 1)];
    uint b = position[first + (at >> 1) + 1u];
    uvec3 steps = (at & 1u) == 0u ? uvec3(a & 0xffffu, a >> 16, b & 0xffffu) : uvec3(a >> 16, b & 0xffffu, b >> 16);
    uint box = first + STEP_WORDS;
    vec3 least = uintBitsToFloat(uvec3(position[box], position[box + 1u], position[box + 2u]));
    vec3 most = uintBitsToFloat(uvec3(position[box + 3u], position[box + 4u], position[box + 5u]));
    // The end points are exact, and no product overflows.
    vec3 share = vec3(steps) / 65535.0;
    return least * (1.0 - share) + most * share;
}
#else
layout(set = 0, binding = 0, std430) readonly buffer Position { Position3 position[]; };

vec3 position_of(uint i) {
    return vec3(position[i].x, position[i].y, position[i].z);
}
#endif

#if STORAGE != STORAGE_SEPARATE
#include "unpack_splat.glsl"

mat3 factor_for(uint i, inout vec3 t0, inout vec3 t1, inout vec3 t2) {
    return factor_of(i);
}
#else
#if COVARIANCE == COVARIANCE_FACTORED
struct Covariance3 { float m[9]; };
#elif COVARIANCE == COVARIANCE_HALF
struct Covariance3 { uint l00_l10, l20_l11, l21_l22; };
#else
struct Covariance3 { float l00, l10, l20, l11, l21, l22; };
#endif

layout(set = 0, binding = 1, std430) readonly buffer Opacity { float opacity[]; };
layout(set = 0, binding = 2, std430) readonly buffer Covariance { Covariance3 covariance[]; };

float opacity_of(uint i) {
    return opacity[i];
}

// Returns a factor of the covariance, and permutes the elements of the vectors into the order of its rows.
mat3 factor_for(uint i, inout vec3 t0, inout vec3 t1, inout vec3 t2) {
#if COVARIANCE == COVARIANCE_FACTORED
    float m[9] = covariance[i].m;
    return mat3(m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]);
#else
    // The signs of the diagonal encode which row of the triangle is x's; see covariance.comp.
    Covariance3 c = covariance[i];
#if COVARIANCE == COVARIANCE_HALF
    vec2 l00_l10 = unpackHalf2x16(c.l00_l10);
    vec2 l20_l11 = unpackHalf2x16(c.l20_l11);
    vec2 l21_l22 = unpackHalf2x16(c.l21_l22);
    float l00 = l00_l10.x, l10 = l00_l10.y, l20 = l20_l11.x, l11 = l20_l11.y, l21 = l21_l22.x, l22 = l21_l22.y;
#else
    float l00 = c.l00, l10 = c.l10, l20 = c.l20, l11 = c.l11, l21 = c.l21, l22 = c.l22;
#endif
    if (floatBitsToInt(l00) < 0) {
        t0 = t0.yzx;
        t1 = t1.yzx;
        t2 = t2.yzx;
    } else if (floatBitsToInt(l11) < 0) {
        t0 = t0.zxy;
        t1 = t1.zxy;
        t2 = t2.zxy;
    }
    return mat3(abs(l00), l10, l20, 0.0, abs(l11), l21, 0.0, 0.0, l22);
#endif
}
#endif
