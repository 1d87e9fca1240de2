#version 460
#extension GL_GOOGLE_include_directive : require

// Puts a corner of a splat's square on the screen. Each instance is a splat, each of its four vertices a corner.

#include "camera.glsl"
#include "live.glsl"

// In an array, a vec3 takes 16 bytes, and a position has 12.
struct Vector { float x, y, z; };
layout(set = 0, binding = 0, std430) readonly buffer Position { Vector position[]; };

void main() {
    Vector p = position[gl_InstanceIndex];
    // x to the right, y down, z forward.
    vec3 at = (camera.view * vec4(p.x, p.y, p.z, 1.0)).xyz;
    vec2 corner = vec2(gl_VertexIndex & 1, gl_VertexIndex >> 1) * 2.0 - 1.0;
    vec2 pixel = camera.focal.xy * at.xy / at.z + 0.5 * camera.viewport.xy + camera.principal.xy + radius * corner;
    // Splats nearer than the near plane are clipped.
    float depth = at.z > camera.depth.x ? 0.0 : -1.0;
    gl_Position = vec4(2.0 * pixel * camera.viewport.zw - 1.0, depth, 1.0);
}
