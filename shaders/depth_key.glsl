// Converts the depth that orders splats, view z or distance, to a sort key of KEY_BITS bits, non-decreasing: near to far.
//
// `float_bits` takes the bits of the float, which sort like the number if it is positive: exact at 32 bits, and still
// exact below that if the scene's depth range has at most 2^KEY_BITS floats. `linear` gives equal steps of depth,
// `logarithmic` equal ratios. `equalised` assigns keys to the classes of depths in proportion to their splats in this frame, in equal steps
// within a class, and uses at most 31 bits. Depths outside of the scene's range are clamped to it, except for 32-bit `float_bits`.
//
// Every step is monotone in floating point too: integer arithmetic, or one correctly rounded operation by a constant.
// That excludes log2() and division by the range, which need not be monotone on every device.

// Computes log2 of a positive float in fixed point, with 24 fractional bits. Between powers of two it uses
// log2(1 + m) = m + 0.344 m (1 - m), with an error below 0.008.
uint fixed_log2(float z) {
    uint bits = floatBitsToUint(z);
    uint m = bits << 9;
    uint low, bulge, scaled;
    umulExtended(m, ~m, bulge, low);
    umulExtended(bulge, 1477468750u, scaled, low);
    return ((bits >> 23) << 24) + (m >> 8) + (scaled >> 8);
}

// Scales 0 .. range to KEY_BITS bits; returns x unchanged if the range fits. With KEYS_FILL_THEIR_BITS a range that fits is also scaled,
// by a factor above 1 that keeps all x distinct: for sorts by the highest bits first.
uint stretch(uint x, uint range) {
#if KEY_BITS < 32
    bool is_wide = (range >> KEY_BITS) != 0u;
#ifdef KEYS_FILL_THEIR_BITS
    // Not if the range nearly fills them: rounding the factor would lose more than it gains.
    bool is_scaled = is_wide || range < (1u << KEY_BITS) - (1u << (KEY_BITS - 8));
    const float SHARE = 0.9999995;
#else
    bool is_scaled = is_wide;
    const float SHARE = 1.0;
#endif
    if (is_scaled) {
        // x / range in units of 2^-32, times 2^KEY_BITS: the factor is rounded, but it is the same for every key. If the range fits, it
        // is rounded down, so that no key is clamped.
        uint up = 31u - uint(findMSB(max(range, 1u)));
        float factor = exp2(float(KEY_BITS)) * (4294967296.0 / (float(range << up) + 1.0));
        factor *= is_wide ? 1.0 : SHARE;
        uint key, low;
        umulExtended(x << up, uint(min(factor, 4294967040.0)), key, low);
        return min(key, (1u << KEY_BITS) - 1u);
    }
    return x;
#elif defined(KEYS_FILL_THEIR_BITS)
    return x << (31u - uint(findMSB(max(range, 1u))));
#else
    return x;
#endif
}

#if KEY_MAP == KEY_MAP_EQUALISED
#include "depth_classes.glsl"

// The first key of each class, and the end of the last: see equalise.comp.
layout(set = 0, binding = 9, std430) readonly buffer KeyStarts { uint key_starts[]; };

uint depth_key(float z) {
    uint place = depth_place(z);
    uint c = place >> (32u - CLASS_BITS);
    uint start = key_starts[c];
    uint key, low;
    umulExtended(place << CLASS_BITS, key_starts[c + 1u] - start, key, low);
    return start + key;
}
#else
uint depth_key(float z) {
    float near = camera.depth.y;
#if KEY_OF == KEY_OF_DISTANCE
    float far = max(camera.depth.w, near);
#else
    float far = max(camera.depth.z, near);
#endif
#if KEY_MAP == KEY_MAP_FLOAT_BITS
#if KEY_BITS == 32 && !defined(KEYS_FILL_THEIR_BITS)
    return floatBitsToUint(z);
#else
    uint first = floatBitsToUint(near);
    return stretch(floatBitsToUint(clamp(z, near, far)) - first, floatBitsToUint(far) - first);
#endif
#elif KEY_MAP == KEY_MAP_LOGARITHMIC
    uint first = fixed_log2(near);
    return stretch(fixed_log2(clamp(z, near, far)) - first, fixed_log2(far) - first);
#else
    precise float from_near = clamp(z, near, far) - near;
    precise float share = from_near * (1.0 / max(far - near, 1e-30));
    // The largest float below 1 keeps the product below 2^KEY_BITS.
    return uint(min(share, 0.99999994) * exp2(float(KEY_BITS)));
#endif
}
#endif
