// Reads packed splats; packed_splat.glsl has the layout. All functions refer to the splat whose opacity was read last.

#ifndef UNPACK_SPLAT
#define UNPACK_SPLAT

#include "packed_splat.glsl"
#include "rotation.glsl"

// One buffer under two names: colours are read only for visible splats.
layout(set = 0, binding = 1, std430) readonly buffer Opacity { uvec2 outlines[]; };
layout(set = 0, binding = 8, std430) readonly buffer Sh { uvec2 sh[]; };
layout(set = 0, binding = 2, std430) readonly buffer Covariance { float ranges[]; };

#define OUTLINE_PLANES ((OUTLINE_BITS + 63u) / 64u)

uint words[RECORD_WORDS];
float coefficients[4 * SH_PLANES];

uint field(uint at, uint bits) {
    uint shift = at & 31u;
    uint value = words[at >> 5] >> shift;
    if (shift + bits > 32u) {
        value |= words[(at >> 5) + 1u] << (32u - shift);
    }
    return value & ((1u << bits) - 1u);
}

float share(uint at, uint bits) {
    return float(field(at, bits)) / float((1u << bits) - 1u);
}

float block_range(uint i, uint k) {
    return ranges[RANGES * (i >> 8) + k];
}

float opacity_of(uint i) {
    for (uint plane = 0u; plane < OUTLINE_PLANES; plane++) {
        uvec2 v = outlines[plane * uint(SCENE_COUNT) + i];
        words[2u * plane] = v.x;
        words[2u * plane + 1u] = v.y;
    }
    return share(0u, OPACITY_BITS);
}

// Returns R S, a factor of the covariance.
mat3 factor_of(uint i) {
    const uint SCALES = OPACITY_BITS;
    const uint ROTATION = SCALES + 3u * SCALE_BITS;
    const uint REST = ROTATION + 2u;
    const float STEPS = float((1u << (ROTATION_BITS - 1u)) - 1u);
    vec3 shares = vec3(share(SCALES, SCALE_BITS), share(SCALES + SCALE_BITS, SCALE_BITS), share(SCALES + 2u * SCALE_BITS, SCALE_BITS));
    vec3 s = exp2(mix(vec3(block_range(i, 0u)), vec3(block_range(i, 1u)), shares));
    vec3 rest = vec3(field(REST, ROTATION_BITS), field(REST + ROTATION_BITS, ROTATION_BITS), field(REST + 2u * ROTATION_BITS, ROTATION_BITS));
    rest = (rest - STEPS) * (0.70710678118654752 / STEPS);
    float most = sqrt(max(1.0 - dot(rest, rest), 0.0));
    uint largest = field(ROTATION, 2u);
    vec4 q = largest == 0u ? vec4(most, rest) : largest == 1u ? vec4(rest.z, most, rest.xy)
        : largest == 2u ? vec4(rest.yz, most, rest.x) : vec4(rest, most);
    mat3 r = rows_of_rotation(q);
    return transpose(mat3(r[0] * s, r[1] * s, r[2] * s));
}

// Returns the middle of a step of -1 to 1; 0 without steps.
float middle(uint at, uint bits) {
    return bits > 0u ? (float(field(at, bits)) + 0.5) / float((1u << bits) >> 1) - 1.0 : 0.0;
}

void read_band(uint i, uint band, inout uint at, inout uint size, inout vec3 colour) {
    uint along_bits = ALONG_BITS[band - 1u], across_bits = ACROSS_BITS[band - 1u], direction_bits = DIRECTION_BITS[band - 1u];
    if (SIZE_BITS[band - 1u] > 0u) {
        size = field(at, SIZE_BITS[band - 1u]);
        at += SIZE_BITS[band - 1u];
    }
    if (direction_bits > 0u) {
        vec2 shares = vec2(middle(at + 2u, direction_bits), middle(at + 2u + direction_bits, direction_bits));
        colour = direction_from(field(at, 2u), shares);
        at += 2u + 2u * direction_bits;
    }
    uint angle_bits = ANGLE_BITS[band - 1u];
    float angle = angle_bits > 0u ? angle_from(field(at, angle_bits), angle_bits) : 0.0;
    at += angle_bits;
    uint step_bits = along_bits + (angle_bits > 0u ? 1u : 2u) * across_bits;
    float scale = exp2(-0.5 * float(size));
    vec3 along = scale * block_range(i, 3u + band) * colour;
    mat3 basis = basis_of(colour, angle);
    float across = scale * block_range(i, 6u + band);
    for (uint k = first_of(band); k < first_of(band + 1u); k++) {
        vec3 rgb = middle(at, along_bits) * along;
        if (across_bits > 0u) {
            rgb += across * middle(at + along_bits, across_bits) * basis[1];
            if (angle_bits == 0u) {
                rgb += across * middle(at + along_bits + across_bits, across_bits) * basis[2];
            }
        }
        coefficients[3u * k] = rgb.r;
        coefficients[3u * k + 1u] = rgb.g;
        coefficients[3u * k + 2u] = rgb.b;
        at += step_bits;
    }
}

// Reads the harmonics of splat `i`, for `sh_plane`.
void read_harmonics(uint i) {
    for (uint plane = OUTLINE_PLANES; plane < uint(RECORD_PLANES); plane++) {
        uvec2 v = sh[plane * uint(SCENE_COUNT) + i];
        words[2u * plane] = v.x;
        words[2u * plane + 1u] = v.y;
    }
    float least = block_range(i, 2u), most = block_range(i, 3u);
    uint at = OUTLINE_BITS;
    for (uint c = 0u; c < 3u; c++) {
        coefficients[c] = mix(least, most, share(at, COLOUR_BITS));
        at += COLOUR_BITS;
    }
    uint size = 0u;
    vec3 colour = vec3(1.0);
#if SH_DEGREE >= 1
    read_band(i, 1u, at, size, colour);
#endif
#if SH_DEGREE >= 2
    read_band(i, 2u, at, size, colour);
#endif
#if SH_DEGREE >= 3
    read_band(i, 3u, at, size, colour);
#endif
}

#define sh_plane(plane, i) \
    vec4(coefficients[4u * plane], coefficients[4u * plane + 1u], coefficients[4u * plane + 2u], coefficients[4u * plane + 3u])

#endif
