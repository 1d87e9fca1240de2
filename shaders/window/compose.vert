#version 460
#extension GL_GOOGLE_include_directive : require

// Makes the rectangle of the view.

#include "window.glsl"

void main() {
    vec2 first = vec2(window.view.xy);
    gl_Position = corner(first, first + vec2(window.view.zw), gl_VertexIndex);
}
