#version 460
#extension GL_GOOGLE_include_directive : require

// Makes the rectangle of the view.

#include "window.glsl"

// Members of the block, for the fragment shader's conditions. A fragment shader with conditions on a uniform block is compiled
// anew for each draw by lavapipe (Mesa 22.3), which frees the results only with the pipeline.
layout(location = 0) flat out uvec4 picture_a;
layout(location = 1) flat out uvec4 picture_b;
layout(location = 2) flat out uint mode;

void main() {
    picture_a = window.picture_a;
    picture_b = window.picture_b;
    mode = window.mode;
    vec2 first = vec2(window.view.xy);
    gl_Position = corner(first, first + vec2(window.view.zw), gl_VertexIndex);
}
