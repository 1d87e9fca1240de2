// The layout of packed splats, written by pack_splats.comp and read by unpack_splat.glsl.
//
// A splat is a record of RECORD_PLANES times 64 bits. Its fields are packed from the lowest bit on: opacity, three scales, the
// rotation, the constant colour, and then for each band of harmonics its size and its coefficients. The records are stored by
// planes: plane p of splat i is element p SCENE_COUNT + i.
//
// - The opacity, the constant coefficients and the logarithms of the scales have steps of equal size.
// - The rotation is the index of its largest quaternion element, and the three others, from -1/sqrt(2) to 1/sqrt(2).
// - The three channels of a band mostly differ by factors: the band is close to one colour times one pattern over the sphere. The record
//   has the direction of that colour, and each coefficient as its part along the colour and two parts across it (or one, at an
//   angle). They have 2^bits steps in -s to s, with no step at 0, which suits few bits best. s is the block's largest part times
//   2^(-size / 2), with the size of the least squared error.
// - A direction is the index of its largest element, and the others as shares of it.
//
// Scales, colours and bands have the ranges of their block of 256 consecutive splats: RANGES floats per block.

#include "sh_layout.glsl"

// Bits of the fields; arrays are by band. A band without its own size or direction has the previous band's.
#if STORAGE == STORAGE_B64
#define OPACITY_BITS 10u
#define SCALE_BITS 12u
#define ROTATION_BITS 12u
#define COLOUR_BITS 12u
const uint SIZE_BITS[3] = uint[3](4u, 4u, 4u);
const uint DIRECTION_BITS[3] = uint[3](2u, 2u, 1u);
const uint ANGLE_BITS[3] = uint[3](0u, 0u, 0u);
const uint ALONG_BITS[3] = uint[3](8u, 8u, 8u);
const uint ACROSS_BITS[3] = uint[3](6u, 6u, 6u);
#elif STORAGE == STORAGE_B32
#define OPACITY_BITS 8u
#define SCALE_BITS 8u
#define ROTATION_BITS 9u
#define COLOUR_BITS 9u
const uint SIZE_BITS[3] = uint[3](3u, 3u, 0u);
const uint DIRECTION_BITS[3] = uint[3](3u, 3u, 2u);
const uint ANGLE_BITS[3] = uint[3](3u, 3u, 0u);
const uint ALONG_BITS[3] = uint[3](5u, 4u, 2u);
const uint ACROSS_BITS[3] = uint[3](3u, 2u, 0u);
#else
#define OPACITY_BITS 7u
#define SCALE_BITS 7u
#define ROTATION_BITS 8u
#define COLOUR_BITS 8u
const uint SIZE_BITS[3] = uint[3](4u, 0u, 0u);
const uint DIRECTION_BITS[3] = uint[3](2u, 2u, 0u);
const uint ANGLE_BITS[3] = uint[3](0u, 0u, 0u);
const uint ALONG_BITS[3] = uint[3](4u, 3u, 1u);
const uint ACROSS_BITS[3] = uint[3](0u, 0u, 0u);
#endif

#if STORAGE == STORAGE_B24
#define RECORD_PLANES 2
#elif STORAGE == STORAGE_B32
#define RECORD_PLANES (SH_DEGREE < 2 ? 2 : 3)
#else
#define RECORD_PLANES (SH_DEGREE < 2 ? 2 + SH_DEGREE : 2 * SH_DEGREE + 1)
#endif
#define RECORD_WORDS (2 * RECORD_PLANES)
#define OUTLINE_BITS (OPACITY_BITS + 3u * SCALE_BITS + 2u + 3u * ROTATION_BITS)

// Minimum and maximum logarithm of a scale; minimum and maximum constant coefficient; each band's largest part along, then each across.
const uint RANGES = 10u;

// Returns an orthonormal basis whose first vector is `along`; the others are rotated by an angle.
mat3 basis_of(vec3 along, float angle) {
    vec3 u = normalize(cross(along, abs(along.x) < 0.6 ? vec3(1.0, 0.0, 0.0) : vec3(0.0, 1.0, 0.0)));
    vec3 v = cross(along, u);
    vec3 across = cos(angle) * u + sin(angle) * v;
    return mat3(along, across, cross(along, across));
}

// Returns the angle of a step of half a turn.
float angle_from(uint step, uint bits) {
    return bits > 0u ? ((float(step) + 0.5) / float(1u << bits) - 0.5) * 3.14159265358979 : 0.0;
}

// Returns the direction with these two shares of its largest element.
vec3 direction_from(uint largest, vec2 shares) {
    vec3 v = vec3(1.0, shares);
    return normalize(largest == 0u ? v : largest == 1u ? v.zxy : v.yzx);
}

// Returns the first coefficient of a band.
uint first_of(uint band) {
    return band * band;
}
