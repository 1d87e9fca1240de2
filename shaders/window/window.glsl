// The viewer's window in a frame, 80 bytes from the host. Lengths are in pixels, colours display-encoded.
layout(set = 0, binding = 30, std140) uniform Window {
    uvec4 view;           // place of the scene: left, top, width, height
    uvec4 picture_a;      // width, height, format (below), rows of a part
    uvec4 picture_b;
    vec2 size;            // of the window
    float split;          // place of the split line: 0 at the view's left border, 1 at its right one
    float amplification;  // of differences
    uint mode;            // below
} window;

const uint FORMAT_NONE = 0u;  // no such picture
const uint FORMAT_RGBA8 = 1u;
const uint FORMAT_RGBA16F = 2u;
const uint FORMAT_RGBA32F = 3u;
const uint FORMAT_R32F = 4u;  // shown as grey

// Unpacks a pixel from its words with r, g and b, and clamps it to 0..1 as on a display. The last word is `words.z`.
vec3 unpack(uint format, uvec3 words) {
    vec3 colour;
    switch (format) {
    case FORMAT_RGBA8:
        colour = unpackUnorm4x8(words.z).rgb;
        break;
    case FORMAT_RGBA16F:
        colour = vec3(unpackHalf2x16(words.y), unpackHalf2x16(words.z).x);
        break;
    case FORMAT_RGBA32F:
        colour = uintBitsToFloat(words);
        break;
    default:
        colour = vec3(uintBitsToFloat(words.z));
        break;
    }
    return clamp(colour, 0.0, 1.0);
}

// Returns the number of words of a pixel.
uint words_of(uint format) {
    return format == FORMAT_RGBA16F ? 2u : format == FORMAT_RGBA32F ? 4u : 1u;
}

// Returns the clip-space position of vertex 0 to 5 of a rectangle that is drawn as two triangles. Lengths are in pixels.
vec4 corner(vec2 first, vec2 beyond, int vertex) {
    vec2 share = vec2(vertex == 1 || vertex >= 4 ? 1.0 : 0.0, vertex >= 2 && vertex != 4 ? 1.0 : 0.0);
    return vec4(2.0 * mix(first, beyond, share) / window.size - 1.0, 0.0, 1.0);
}

const uint MODE_A = 0u;
const uint MODE_SPLIT = 1u;
const uint MODE_DIFFERENCE = 2u;
