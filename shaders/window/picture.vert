#version 460
#extension GL_GOOGLE_include_directive : require

// Makes the rectangle of a part of picture A, which is as large as the view.

#include "window.glsl"

layout(push_constant) uniform Push { uint part; };

layout(location = 0) flat out uint first_row;

void main() {
    uint rows = window.picture_a.w;
    first_row = part * rows;
    uint beyond = min(first_row + rows, window.picture_a.y);
    vec2 place = vec2(window.view.xy);
    vec2 first = place + vec2(0.0, float(first_row));
    gl_Position = corner(first, place + vec2(float(window.picture_a.x), float(beyond)), gl_VertexIndex);
}
