// Reorders the splats of a pixel by their depth there: the nearest of PIXEL_WINDOW + 1 splats is blended next. Radl et al. 2024,
// "StopThePop", resort in such windows, too.

// The colour and the alpha of a splat at a pixel.
struct Light { vec3 colour; float alpha; };

// A light in the form in which it waits: alpha has 16 bits, as exact as the colours' half floats.
#if RECORD == RECORD_F32
#define StoredLight vec4

StoredLight pack_light(vec3 colour, float alpha) {
    return vec4(colour, alpha);
}

Light unpack_light(StoredLight s) {
    return Light(s.rgb, s.a);
}
#else
#define StoredLight uvec2

StoredLight pack_light(vec3 colour, float alpha) {
    uint blue = packHalf2x16(vec2(colour.b, 0.0));
    return uvec2(packHalf2x16(colour.rg), blue | (uint(alpha * 65535.0 + 0.5) << 16));
}

Light unpack_light(StoredLight s) {
    return Light(vec3(unpackHalf2x16(s.x), unpackHalf2x16(s.y & 0xffffu).x), float(s.y >> 16) / 65535.0);
}
#endif

// The waiting splats of a pixel, near to far.
struct Window {
    float depths[PIXEL_WINDOW];
    StoredLight lights[PIXEL_WINDOW];
#if WITH_OUTPUTS
    uint indices[PIXEL_WINDOW];
#endif
};

// Returns a window of transparent splats in front of all others.
Window empty_window() {
    Window w;
    [[unroll]] for (uint i = 0u; i < uint(PIXEL_WINDOW); i++) {
        w.depths[i] = -3e38;
        w.lights[i] = pack_light(vec3(0.0), 0.0);
#if WITH_OUTPUTS
        w.indices[i] = 0u;
#endif
    }
    return w;
}

// Inserts a splat and returns the nearest one in its place. Of splats of equal depth, the one added first counts as nearer.
void push(inout Window w, float depth, inout StoredLight light AND(inout uint index)) {
    // An insertion sort, from far to near: each nearer splat moves one place to the front, and the nearest leaves the window.
    [[unroll]] for (int i = PIXEL_WINDOW - 1; i >= 0; i--) {
        bool is_behind = depth >= w.depths[i];
        float pushed_depth = is_behind ? w.depths[i] : depth;
        StoredLight pushed_light = is_behind ? w.lights[i] : light;
        w.depths[i] = is_behind ? depth : w.depths[i];
        w.lights[i] = is_behind ? light : w.lights[i];
#if WITH_OUTPUTS
        uint pushed_index = is_behind ? w.indices[i] : index;
        w.indices[i] = is_behind ? index : w.indices[i];
        index = pushed_index;
#endif
        depth = pushed_depth;
        light = pushed_light;
    }
}

// Blends a splat over a pixel, whose alpha floor becomes 2 when it is done.
void blend(inout vec3 colour, inout float light, inout float least, StoredLight stored AND(inout Pixel pixel) AND(uint index)) {
    Light splat = unpack_light(stored);
    float share = least == 2.0 ? 0.0 : splat.alpha * light;
#if STOP_AFTER == STOP_AFTER_SPLAT
    bool stops = light - share < stop;
    least = stops ? 2.0 : least;
    share = stops ? 0.0 : share;
#endif
#if WITH_OUTPUTS
    add_splat(pixel, seen_splat(index), share, light, stop);
#endif
    colour += share * splat.colour;
    light -= share;
}
