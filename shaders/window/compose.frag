#version 460
#extension GL_GOOGLE_include_directive : require

// Draws the scene's part of the window where picture.frag cannot: A and B with a line between them, their difference, or a picture
// of another size. Pictures are buffers, row 0 at the top, with pixels packed in their format. Each has four parts of whole rows.

#include "window.glsl"

layout(set = 0, binding = 0, std430) readonly buffer PictureA0 { uint picture_a0[]; };
layout(set = 0, binding = 1, std430) readonly buffer PictureA1 { uint picture_a1[]; };
layout(set = 0, binding = 2, std430) readonly buffer PictureA2 { uint picture_a2[]; };
layout(set = 0, binding = 3, std430) readonly buffer PictureA3 { uint picture_a3[]; };
layout(set = 0, binding = 4, std430) readonly buffer PictureB0 { uint picture_b0[]; };
layout(set = 0, binding = 5, std430) readonly buffer PictureB1 { uint picture_b1[]; };
layout(set = 0, binding = 6, std430) readonly buffer PictureB2 { uint picture_b2[]; };
layout(set = 0, binding = 7, std430) readonly buffer PictureB3 { uint picture_b3[]; };

// Equal to the members of the block; see compose.vert.
layout(location = 0) flat in uvec4 picture_a;
layout(location = 1) flat in uvec4 picture_b;
layout(location = 2) flat in uint mode;

layout(location = 0) out vec4 shown;

// Reads a word of a part: 0 to 3 of picture A, 4 to 7 of B.
uint word(uint part, uint i) {
    switch (part) {
    case 0u: return picture_a0[i];
    case 1u: return picture_a1[i];
    case 2u: return picture_a2[i];
    case 3u: return picture_a3[i];
    case 4u: return picture_b0[i];
    case 5u: return picture_b1[i];
    case 6u: return picture_b2[i];
    default: return picture_b3[i];
    }
}

// Reads a pixel, clamped to the border.
vec3 texel(bool b, uvec4 picture, ivec2 at) {
    at = clamp(at, ivec2(0), ivec2(picture.xy) - 1);
    uint part = uint(at.y) / picture.w;
    uint pixel = (uint(at.y) - part * picture.w) * picture.x + uint(at.x);
    part += b ? 4u : 0u;
    uint stride = words_of(picture.z);
    uvec3 read = uvec3(0u);
    for (uint i = 0u; i < min(stride, 3u); i++) {
        read = uvec3(read.yz, word(part, stride * pixel + i));
    }
    return unpack(picture.z, read);
}

// Samples a picture at a position in the view, in pixels from its top left corner.
vec3 picture(bool b, vec2 at) {
    uvec4 picture = b ? picture_b : picture_a;
    vec2 size = vec2(picture.xy);
    bool same = picture.xy == window.view.zw;
    // A picture of another size was drawn before the view was resized. The next one will have the same vertical field of
    // view, so this one is scaled to the view's height.
    vec2 place = (at - 0.5 * vec2(window.view.zw)) * (size.y / float(window.view.w)) + 0.5 * size;
    // Sizes are rounded to whole pixels, so half a pixel beyond the border is still covered.
    bool covered = same || (all(greaterThanEqual(place, vec2(-0.5))) && all(lessThanEqual(place, size + 0.5)));
    if (picture.z == FORMAT_NONE || !covered) {
        return vec3(0.0);
    }
    vec2 corner = same ? floor(at) : floor(place - 0.5);
    vec2 share = same ? vec2(0.0) : place - 0.5 - corner;
    vec3 sum = vec3(0.0);
    for (int i = 0; i < (same ? 1 : 4); i++) {
        ivec2 next = ivec2(i & 1, i >> 1);
        vec2 weight = mix(1.0 - share, share, vec2(next));
        sum += weight.x * weight.y * texel(b, picture, ivec2(corner) + next);
    }
    return sum;
}

// CPU drivers execute all branches of a condition, but no loop iteration that no lane needs. So pictures, pixels and words
// are read in loops, and each read appears once.
void main() {
    vec2 at = gl_FragCoord.xy - vec2(window.view.xy);
    vec3 colour = vec3(0.0);
    if (all(greaterThanEqual(at, vec2(0.0))) && all(lessThan(at, vec2(window.view.zw)))) {
        // Split, A is to the left of the line and B to the right.
        bool is_split = mode == MODE_SPLIT;
        float from_line = floor(at.x) - round(window.split * float(window.view.z));
        bool b = is_split && from_line > 0.0;
        colour = picture(b, at);
        for (uint i = 0u; i < (mode == MODE_DIFFERENCE ? 1u : 0u); i++) {
            colour = window.amplification * abs(colour - picture(true, at));
        }
        // The line is two pixels wide, black and white, to be visible on any picture.
        if (is_split && (from_line == -1.0 || from_line == 0.0)) {
            colour = vec3(from_line + 1.0);
        }
    }
    shown = vec4(colour, 1.0);
}
