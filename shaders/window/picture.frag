#version 460
#extension GL_GOOGLE_include_directive : require

// Copies a part of picture A to the view, pixel by pixel: the common case, which compose.frag would draw more slowly.

#include "window.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Picture { uint picture[]; };

layout(location = 0) flat in uint first_row;

layout(location = 0) out vec4 shown;

void main() {
    uvec2 at = uvec2(gl_FragCoord.xy) - window.view.xy;
    uint format = window.picture_a.z;
    uint stride = words_of(format);
    // Clamped, because helper invocations lie beside the part.
    uint pixel = min((at.y - first_row) * window.picture_a.x + at.x, uint(picture.length()) / stride - 1u);
    uvec3 read = uvec3(0u);
    // A loop, because CPU drivers execute all branches of a condition, but no loop iteration that no lane needs.
    for (uint i = 0u; i < min(stride, 3u); i++) {
        read = uvec3(read.yz, picture[stride * pixel + i]);
    }
    shown = vec4(unpack(format, read), 1.0);
}
