#version 460
#extension GL_GOOGLE_include_directive : require

// Packs everything but a splat's position into a record, once per scene; packed_splat.glsl has the layout. A workgroup takes a block of
// 256 splats, and first finds the ranges of the block.

#include "groups.glsl"
#include "ordered_floats.glsl"
#include "packed_splat.glsl"
#include "sh_planes.glsl"

layout(local_size_x = 256) in;

struct Scale3 { float x, y, z; };

layout(set = 0, binding = SH_PLANES, std430) readonly buffer Scale { Scale3 scale[]; };
layout(set = 0, binding = SH_PLANES + 1, std430) readonly buffer Rotation { vec4 rotation[]; };  // w, x, y, z
layout(set = 0, binding = SH_PLANES + 2, std430) readonly buffer Opacity { float opacity[]; };
layout(set = 0, binding = SH_PLANES + 3, std430) writeonly buffer Records { uvec2 records[]; };
layout(set = 0, binding = SH_PLANES + 4, std430) writeonly buffer Ranges { float ranges[]; };

// Larger coefficients are clamped to this one, so that sums and differences stay finite.
const float LARGEST = 1e30;
// Scales that are more octaves than this below the block's largest are clamped.
const float OCTAVES = 20.0;

shared uint bounds[RANGES];

// By coefficient, the components along and across the colour of its band.
vec3 parts[16];
// By band, the fields of the colour's direction.
uvec4 directions[4];
uint words[RECORD_WORDS];
uint filled = 0u;

void put(uint value, uint bits) {
    uint word = filled >> 5;
    uint shift = filled & 31u;
    if (bits > 0u) {
        words[word] |= value << shift;
        if (shift + bits > 32u) {
            words[word + 1u] |= value >> (32u - shift);
        }
    }
    filled += bits;
}

// Packs the nearest of 2^bits steps from `least` to `most`.
void put_share(float x, float least, float most, uint bits) {
    float share = most > least ? clamp((x - least) / (most - least), 0.0, 1.0) : 0.0;
    put(uint(share * float((1u << bits) - 1u) + 0.5), bits);
}

float coefficient(uint at) {
    return clamp(planes[at >> 2][at & 3u], -LARGEST, LARGEST);
}

// Returns the step of -s to s that contains x.
uint step_of(float x, float s, uint bits) {
    float half_count = float((1u << bits) >> 1);
    return bits > 0u && s > 0.0 ? uint(clamp(floor(x / s * half_count) + half_count, 0.0, 2.0 * half_count - 1.0)) : 0u;
}

// Returns the squared error of rounding to a step.
float cost(float x, float s, uint bits) {
    float half_count = float((1u << bits) >> 1);
    float rounded = bits > 0u && s > 0.0 ? (float(step_of(x, s, bits)) - half_count + 0.5) / half_count * s : 0.0;
    return (x - rounded) * (x - rounded);
}

// Returns the scale of a block's range for a size.
float range_of(uint bound, uint size) {
    return from_order(bounds[bound]) * exp2(-0.5 * float(size));
}

float cost_of_band(uint band, uint size) {
    float along = range_of(3u + band, size);
    float across = range_of(6u + band, size);
    float sum = 0.0;
    for (uint k = first_of(band); k < first_of(band + 1u); k++) {
        vec3 v = parts[k];
        sum += cost(v.x, along, ALONG_BITS[band - 1u]);
        if (ACROSS_BITS[band - 1u] > 0u) {
            sum += cost(v.y, across, ACROSS_BITS[band - 1u]);
            sum += ANGLE_BITS[band - 1u] > 0u ? 0.0 : cost(v.z, across, ACROSS_BITS[band - 1u]);
        }
    }
    return sum;
}

// Finds the principal colour of a band, or keeps `colour`, and splits the coefficients into components along and across it.
void split(uint band, inout vec3 colour) {
    uint bits = DIRECTION_BITS[band - 1u];
    if (bits > 0u) {
        mat3 sums = mat3(0.0);
        float most = 0.0;
        for (uint k = 3u * first_of(band); k < 3u * first_of(band + 1u); k++) {
            most = max(most, abs(coefficient(k)));
        }
        for (uint k = first_of(band); k < first_of(band + 1u); k++) {
            vec3 c = vec3(coefficient(3u * k), coefficient(3u * k + 1u), coefficient(3u * k + 2u)) / max(most, 1e-30);
            sums += outerProduct(c, c);
        }
        // The eigenvector of the largest eigenvalue, by powers of the matrix.
        float trace = max(max(sums[0].x, sums[1].y), sums[2].z);
        for (uint step = 0u; step < 6u && trace > 0.0; step++) {
            sums /= trace;
            sums = sums * sums;
            trace = max(max(sums[0].x, sums[1].y), sums[2].z);
        }
        uint largest = sums[0].x >= sums[1].y && sums[0].x >= sums[2].z ? 0u : sums[1].y >= sums[2].z ? 1u : 2u;
        vec3 v = sums[largest] / max(sums[largest][largest], 1e-30);
        directions[band].xyz = uvec3(largest, step_of(v[(largest + 1u) % 3u], 1.0, bits), step_of(v[(largest + 2u) % 3u], 1.0, bits));
        colour = direction_from(largest, (vec2(directions[band].yz) + 0.5) / float((1u << bits) >> 1) - 1.0);
    }
    mat3 basis = basis_of(colour, 0.0);
    vec2 moments = vec2(0.0);
    for (uint k = first_of(band); k < first_of(band + 1u); k++) {
        parts[k] = vec3(coefficient(3u * k), coefficient(3u * k + 1u), coefficient(3u * k + 2u)) * basis;
        moments += vec2(2.0 * parts[k].y * parts[k].z, parts[k].y * parts[k].y - parts[k].z * parts[k].z);
    }
    uint angle_bits = ANGLE_BITS[band - 1u];
    directions[band].w = 0u;
    if (angle_bits > 0u && (moments.x != 0.0 || moments.y != 0.0)) {
        float angle = 0.5 * atan(moments.x, moments.y);
        directions[band].w = uint(floor((angle / 3.14159265358979 + 0.5) * float(1u << angle_bits))) & ((1u << angle_bits) - 1u);
    }
    mat3 turned = basis_of(colour, angle_from(directions[band].w, angle_bits));
    for (uint k = first_of(band); k < first_of(band + 1u); k++) {
        parts[k] = basis * parts[k] * turned;
        parts[k].z = angle_bits > 0u ? 0.0 : parts[k].z;
    }
}

// Returns the last band that shares the size of `band`.
uint last_with_size_of(uint band) {
    uint last = band;
    while (last < uint(SH_DEGREE) && SIZE_BITS[last] == 0u) {
        last++;
    }
    return last;
}

uint best_size(uint band) {
    uint best = 0u;
    float least = -1.0;
    for (uint size = 0u; size < (1u << SIZE_BITS[band - 1u]); size++) {
        float sum = 0.0;
        for (uint other = band; other <= last_with_size_of(band); other++) {
            sum += cost_of_band(other, size);
        }
        if (least < 0.0 || sum < least) {
            least = sum;
            best = size;
        }
    }
    return best;
}

void put_bands() {
    uint size = 0u;
    for (uint band = 1u; band <= uint(SH_DEGREE); band++) {
        if (SIZE_BITS[band - 1u] > 0u) {
            size = best_size(band);
            put(size, SIZE_BITS[band - 1u]);
        }
        if (DIRECTION_BITS[band - 1u] > 0u) {
            put(directions[band].x, 2u);
            put(directions[band].y, DIRECTION_BITS[band - 1u]);
            put(directions[band].z, DIRECTION_BITS[band - 1u]);
        }
        put(directions[band].w, ANGLE_BITS[band - 1u]);
        float along = range_of(3u + band, size);
        float across = range_of(6u + band, size);
        for (uint k = first_of(band); k < first_of(band + 1u); k++) {
            put(step_of(parts[k].x, along, ALONG_BITS[band - 1u]), ALONG_BITS[band - 1u]);
            put(step_of(parts[k].y, across, ACROSS_BITS[band - 1u]), ACROSS_BITS[band - 1u]);
            if (ANGLE_BITS[band - 1u] == 0u) {
                put(step_of(parts[k].z, across, ACROSS_BITS[band - 1u]), ACROSS_BITS[band - 1u]);
            }
        }
    }
}

// Packs the index of the largest element, and the others divided by its sign.
void put_rotation(vec4 q) {
    uint largest = 0u;
    for (uint k = 1u; k < 4u; k++) {
        largest = abs(q[k]) > abs(q[largest]) ? k : largest;
    }
    put(largest, 2u);
    float unit = (q[largest] < 0.0 ? -1.0 : 1.0) * 1.4142135623730951 * float((1u << (ROTATION_BITS - 1u)) - 1u);
    for (uint k = 1u; k < 4u; k++) {
        int steps = int((1u << (ROTATION_BITS - 1u)) - 1u);
        put(uint(clamp(int(round(q[(largest + k) & 3u] * unit)), -steps, steps) + steps), ROTATION_BITS);
    }
}

void main() {
    uint block = group_index();
    uint thread = gl_LocalInvocationIndex;
    uint i = block * 256u + thread;
    if (thread < RANGES) {
        bounds[thread] = thread == 0u || thread == 2u ? 0xffffffffu : in_order(thread < 4u ? uintBitsToFloat(0xff800000u) : 0.0);
    }
    barrier();
    bool exists = i < uint(SCENE_COUNT);
    vec3 logarithms = vec3(0.0);
    if (exists) {
        load_planes(i);
        logarithms = log2(clamp(vec3(scale[i].x, scale[i].y, scale[i].z), 1e-37, 1e18));
        for (uint c = 0u; c < 3u; c++) {
            atomicMin(bounds[0], in_order(logarithms[c]));
            atomicMax(bounds[1], in_order(logarithms[c]));
            atomicMin(bounds[2], in_order(coefficient(c)));
            atomicMax(bounds[3], in_order(coefficient(c)));
        }
        vec3 colour = vec3(1.0);
        for (uint band = 1u; band <= uint(SH_DEGREE); band++) {
            split(band, colour);
            for (uint k = first_of(band); k < first_of(band + 1u); k++) {
                vec3 v = abs(parts[k]);
                atomicMax(bounds[3u + band], in_order(v.x));
                atomicMax(bounds[6u + band], in_order(max(v.y, v.z)));
            }
        }
    }
    barrier();
    float largest = from_order(bounds[1]);
    float smallest = max(from_order(bounds[0]), largest - OCTAVES);
    if (thread < RANGES && block < uint(BLOCK_COUNT)) {
        ranges[RANGES * block + thread] = thread == 0u ? smallest : from_order(bounds[thread]);
    }
    if (!exists) {
        return;
    }
    for (uint word = 0u; word < uint(RECORD_WORDS); word++) {
        words[word] = 0u;
    }
    put_share(opacity[i], 0.0, 1.0, OPACITY_BITS);
    for (uint c = 0u; c < 3u; c++) {
        put_share(logarithms[c], smallest, largest, SCALE_BITS);
    }
    put_rotation(rotation[i]);
    for (uint c = 0u; c < 3u; c++) {
        put_share(coefficient(c), from_order(bounds[2]), from_order(bounds[3]), COLOUR_BITS);
    }
    put_bands();
    for (uint plane = 0u; plane < uint(RECORD_PLANES); plane++) {
        records[plane * uint(SCENE_COUNT) + i] = uvec2(words[2u * plane], words[2u * plane + 1u]);
    }
}
