// Textures of materials, in one storage buffer. A texture is the index of its first texel, and its width (lower 16 bits) and height
// (upper 16 bits). Addressing repeats, and filtering is bilinear.

layout(set = 0, binding = 6, std430) readonly buffer Texels { uint texels[]; };

bool has_image(uvec2 image) {
    return image.y != 0u;
}

// Converts between display-encoded and linear values (IEC 61966-2-1).
float decode(float c) {
    return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4);
}

float encode(float c) {
    return c <= 0.0031308 ? 12.92 * c : 1.055 * pow(c, 1.0 / 2.4) - 0.055;
}

// Returns the texel at column and row, from -1 to one beyond the last. A display-encoded colour is decoded.
vec4 texel(uvec2 image, ivec2 at, bool is_colour) {
    uvec2 size = uvec2(image.y & 0xffffu, image.y >> 16);
    uvec2 wrapped = (uvec2(at + ivec2(size))) % size;
    vec4 c = unpackUnorm4x8(texels[image.x + wrapped.y * size.x + wrapped.x]);
    return is_colour ? vec4(decode(c.r), decode(c.g), decode(c.b), c.a) : c;
}

// Converts uv to texel coordinates, with texel centres at integers.
vec2 place_in(uvec2 image, vec2 uv) {
    return (uv - floor(uv)) * vec2(image.y & 0xffffu, image.y >> 16) - 0.5;
}

// Samples a texture at `uv`. Returns linear values: a display-encoded image needs `is_colour`.
vec4 sample_image(uvec2 image, vec2 uv, bool is_colour) {
    vec2 place = place_in(image, uv);
    ivec2 at = ivec2(floor(place));
    vec2 part = place - vec2(at);
    vec4 upper = mix(texel(image, at, is_colour), texel(image, at + ivec2(1, 0), is_colour), part.x);
    vec4 lower = mix(texel(image, at + ivec2(0, 1), is_colour), texel(image, at + ivec2(1, 1), is_colour), part.x);
    return mix(upper, lower, part.y);
}
