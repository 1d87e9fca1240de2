#version 460
#extension GL_GOOGLE_include_directive : require

// Draws the scene's part of the window: picture A, or A and B with a line between them, or their difference. Pictures are
// buffers, row 0 at the top, with pixels packed in their format. Each has four parts of whole rows.

#include "window.glsl"

layout(set = 0, binding = 0, std430) readonly buffer PictureA0 { uint picture_a0[]; };
layout(set = 0, binding = 1, std430) readonly buffer PictureA1 { uint picture_a1[]; };
layout(set = 0, binding = 2, std430) readonly buffer PictureA2 { uint picture_a2[]; };
layout(set = 0, binding = 3, std430) readonly buffer PictureA3 { uint picture_a3[]; };
layout(set = 0, binding = 4, std430) readonly buffer PictureB0 { uint picture_b0[]; };
layout(set = 0, binding = 5, std430) readonly buffer PictureB1 { uint picture_b1[]; };
layout(set = 0, binding = 6, std430) readonly buffer PictureB2 { uint picture_b2[]; };
layout(set = 0, binding = 7, std430) readonly buffer PictureB3 { uint picture_b3[]; };

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

// Reads a pixel, clamped to 0..1 as on a display; beyond the border, the nearest one.
vec3 texel(bool b, uvec4 picture, ivec2 at) {
    at = clamp(at, ivec2(0), ivec2(picture.xy) - 1);
    uint part = uint(at.y) / picture.w;
    uint i = (uint(at.y) - part * picture.w) * picture.x + uint(at.x);
    part += b ? 4u : 0u;
    vec3 colour;
    switch (picture.z) {
    case FORMAT_RGBA8:
        colour = unpackUnorm4x8(word(part, i)).rgb;
        break;
    case FORMAT_RGBA16F:
        colour = vec3(unpackHalf2x16(word(part, 2u * i)), unpackHalf2x16(word(part, 2u * i + 1u)).x);
        break;
    case FORMAT_RGBA32F:
        colour = uintBitsToFloat(uvec3(word(part, 4u * i), word(part, 4u * i + 1u), word(part, 4u * i + 2u)));
        break;
    default:
        colour = vec3(uintBitsToFloat(word(part, i)));
        break;
    }
    return clamp(colour, 0.0, 1.0);
}

// Samples a picture at a place of the view, in pixels from its top left corner.
vec3 picture(bool b, vec2 at) {
    uvec4 picture = b ? window.picture_b : window.picture_a;
    if (picture.z == FORMAT_NONE) {
        return window.background.rgb;
    }
    if (picture.xy == window.view.zw) {
        return texel(b, picture, ivec2(at));
    }
    // A picture of another size was drawn before the view was resized. The next one will have the same vertical field of
    // view, so this one is scaled to the view's height.
    vec2 size = vec2(picture.xy);
    vec2 place = (at - 0.5 * vec2(window.view.zw)) * (size.y / float(window.view.w)) + 0.5 * size;
    // Sizes are rounded to whole pixels, so half a pixel beyond the border is still covered.
    if (any(lessThan(place, vec2(-0.5))) || any(greaterThan(place, size + 0.5))) {
        return window.background.rgb;
    }
    vec2 corner = floor(place - 0.5);
    vec2 part = place - 0.5 - corner;
    ivec2 first = ivec2(corner);
    vec3 top = mix(texel(b, picture, first), texel(b, picture, first + ivec2(1, 0)), part.x);
    vec3 bottom = mix(texel(b, picture, first + ivec2(0, 1)), texel(b, picture, first + ivec2(1, 1)), part.x);
    return mix(top, bottom, part.y);
}

// Draws A to the left of the line and B to the right. The line is two pixels wide, black and white, to be visible on any
// picture.
vec3 split(vec2 at) {
    float from_line = floor(at.x) - round(window.split * float(window.view.z));
    if (from_line == -1.0 || from_line == 0.0) {
        return vec3(from_line + 1.0);
    }
    return picture(from_line > 0.0, at);
}

void main() {
    vec2 at = gl_FragCoord.xy - vec2(window.view.xy);
    vec3 colour = window.background.rgb;
    if (all(greaterThanEqual(at, vec2(0.0))) && all(lessThan(at, vec2(window.view.zw)))) {
        switch (window.mode) {
        case MODE_SPLIT:
            colour = split(at);
            break;
        case MODE_DIFFERENCE:
            colour = window.amplification * abs(picture(false, at) - picture(true, at));
            break;
        default:
            colour = picture(false, at);
            break;
        }
    }
    shown = vec4(colour, 1.0);
}
