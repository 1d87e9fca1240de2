#version 460
#extension GL_GOOGLE_include_directive : require

// Projects a corner of a triangle, pulled from storage buffers.
//
// Depth is reversed: with the near plane's distance as z of clip space and the view depth as w, the depth buffer holds near / depth, which
// is 1 at the near plane and 0 infinitely far.

#include "../camera.glsl"

struct Vector3 { float x, y, z; };

layout(set = 0, binding = 0, std430) readonly buffer Position { Vector3 position[]; };
layout(set = 0, binding = 1, std430) readonly buffer Normal { Vector3 normal_of[]; };
layout(set = 0, binding = 2, std430) readonly buffer Uv { vec2 uv_of[]; };
layout(set = 0, binding = 3, std430) readonly buffer Index { uint index[]; };
layout(set = 0, binding = 4, std430) readonly buffer MaterialOf { uint material_of[]; };

layout(location = 0) out vec3 from_camera;  // in the world
layout(location = 1) out vec3 normal;
layout(location = 2) out vec2 uv;
layout(location = 3) out float depth;       // view depth
// Derivatives of the position with respect to u and v, constant within a triangle; 0 if its uv coordinates are degenerate.
layout(location = 4) flat out vec3 along_u;
layout(location = 5) flat out vec3 along_v;
layout(location = 6) flat out uint material;

vec3 from_origin(uint vertex) {
    Vector3 p = position[vertex];
    return (vec3(p.x, p.y, p.z) - camera.origin.xyz) - camera.origin_low.xyz;
}

void main() {
    uint triangle = uint(gl_VertexIndex) / 3u;
    uint vertex = index[gl_VertexIndex];
    vec3 d = from_origin(vertex);
    vec3 view = mat3(camera.view) * d + camera.view_origin.xyz;
    from_camera = d + camera.to_origin.xyz;
    normal = vec3(normal_of[vertex].x, normal_of[vertex].y, normal_of[vertex].z);
    uv = uv_of[vertex];
    depth = view.z;
    material = material_of[triangle];

    uint a = index[3u * triangle], b = index[3u * triangle + 1u], c = index[3u * triangle + 2u];
    vec3 to_b = from_origin(b) - from_origin(a), to_c = from_origin(c) - from_origin(a);
    vec2 uv_b = uv_of[b] - uv_of[a], uv_c = uv_of[c] - uv_of[a];
    float area = uv_b.x * uv_c.y - uv_c.x * uv_b.y;
    float inverse_area = area == 0.0 ? 0.0 : 1.0 / area;
    along_u = (to_b * uv_c.y - to_c * uv_b.y) * inverse_area;
    along_v = (to_c * uv_b.x - to_b * uv_c.x) * inverse_area;

    // Pixel centres are at integers (camera.glsl), at halves in the framebuffer: the two halves cancel around the middle of the picture.
    vec2 place = 2.0 * camera.focal.xy * camera.viewport.zw * view.xy + 2.0 * camera.principal.xy * camera.viewport.zw * view.z;
    gl_Position = vec4(place, camera.depth.x, view.z);
}
