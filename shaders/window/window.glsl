// The viewer's window in a frame, 96 bytes from the host. Lengths are in pixels, colours display-encoded.
layout(set = 0, binding = 30, std140) uniform Window {
    uvec4 view;           // place of the scene: left, top, width, height
    uvec4 picture_a;      // width, height, format (below), rows of a part
    uvec4 picture_b;
    vec4 background;      // r, g, b around the pictures; w unused
    vec2 size;            // of the window
    float split;          // place of the split line: 0 at the view's left border, 1 at its right one
    float amplification;  // of differences
    uint mode;            // below
} window;

const uint FORMAT_NONE = 0u;  // there is no such picture
const uint FORMAT_RGBA8 = 1u;
const uint FORMAT_RGBA16F = 2u;
const uint FORMAT_RGBA32F = 3u;
const uint FORMAT_R32F = 4u;  // shown as grey

const uint MODE_A = 0u;
const uint MODE_SPLIT = 1u;
const uint MODE_DIFFERENCE = 2u;
