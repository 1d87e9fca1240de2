#version 460
#extension GL_GOOGLE_include_directive : require

// Shades a pixel of egui's meshes: texture times colour, inside the clip rectangle. All textures are in one buffer and are
// filtered here.

#include "ui.glsl"

layout(set = 0, binding = 2, std430) readonly buffer Clips { Clip clips[]; };
layout(set = 0, binding = 3, std430) readonly buffer Texels { uint texels[]; };

layout(location = 0) in vec2 uv;
layout(location = 1) in vec4 colour;
layout(location = 2) flat in uint clip;

layout(location = 0) out vec4 blended;

vec4 texel(Clip c, ivec2 at) {
    at = clamp(at, ivec2(0), ivec2(c.width, c.height) - 1);
    return unpackUnorm4x8(texels[c.texels + uint(at.y) * c.width + uint(at.x)]);
}

void main() {
    Clip c = clips[clip];
    vec2 place = uv * vec2(c.width, c.height);
    // Texels per pixel. Derivatives are taken before any pixel of a quad is discarded.
    float density = max(length(dFdx(place)), length(dFdy(place)));
    if (any(lessThan(gl_FragCoord.xy, c.first)) || any(greaterThan(gl_FragCoord.xy, c.beyond))) {
        discard;
    }
    vec4 texture_colour;
    if (uv == vec2(0.0)) {
        // egui's white texel, for areas of one colour, which are most of a user interface.
        texture_colour = vec4(1.0);
    } else if ((c.smoothing & (density > 1.001 ? SMOOTH_MINIFIED : SMOOTH_MAGNIFIED)) != 0u) {
        vec2 corner = floor(place - 0.5);
        vec2 part = place - 0.5 - corner;
        ivec2 first = ivec2(corner);
        vec4 top = mix(texel(c, first), texel(c, first + ivec2(1, 0)), part.x);
        vec4 bottom = mix(texel(c, first + ivec2(0, 1)), texel(c, first + ivec2(1, 1)), part.x);
        texture_colour = mix(top, bottom, part.y);
    } else {
        texture_colour = texel(c, ivec2(floor(place)));
    }
    blended = colour * texture_colour;
}
