#version 460
#extension GL_GOOGLE_include_directive : require

// Fetches the triangles of egui's meshes by their indices.

#include "ui.glsl"
#include "window.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Vertices { Vertex vertices[]; };
layout(set = 0, binding = 1, std430) readonly buffer Indices { uint indices[]; };

layout(location = 0) out vec2 uv;
layout(location = 1) out vec4 colour;
layout(location = 2) flat out uint clip;

void main() {
    Vertex vertex = vertices[indices[gl_VertexIndex]];
    gl_Position = vec4(2.0 * vertex.position / window.size - 1.0, 0.0, 1.0);
    uv = vertex.uv;
    colour = unpackUnorm4x8(vertex.colour);
    clip = vertex.clip;
}
