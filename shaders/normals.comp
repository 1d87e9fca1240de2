#version 460
#extension GL_GOOGLE_include_directive : require

// Finds the normal of every splat: its shortest axis in world space, facing the camera (against the view direction in an
// orthographic view); of equally short axes, the first.

#include "camera.glsl"
#include "groups.glsl"
#include "rotation.glsl"

layout(local_size_x = 256) in;

struct Vector3 { float x, y, z; };
#if SCENE_WIDE
struct Position3 { float x, y, z, low_x, low_y, low_z; };
#else
struct Position3 { float x, y, z; };
#endif

layout(set = 0, binding = 0, std430) readonly buffer Position { Position3 position[]; };
layout(set = 0, binding = 1, std430) readonly buffer Scale { Vector3 scale[]; };
layout(set = 0, binding = 2, std430) readonly buffer Rotation { vec4 rotation[]; };  // w, x, y, z
layout(set = 0, binding = 3, std430) writeonly buffer Normals { vec4 normals[]; };

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i >= uint(SCENE_COUNT)) {
        return;
    }
    // The columns of the rotation are the axes.
    mat3 axes = transpose(rows_of_rotation(rotation[i]));
    Vector3 s = scale[i];
    vec3 normal = axes[0];
    float shortest = s.x;
    if (s.y < shortest) {
        normal = axes[1];
        shortest = s.y;
    }
    if (s.z < shortest) {
        normal = axes[2];
    }
#if PARALLEL
    // The view's z axis.
    vec3 from_camera = vec3(camera.view[0].z, camera.view[1].z, camera.view[2].z);
#else
    Position3 p = position[i];
#if SCENE_WIDE
    vec3 low = vec3(p.low_x, p.low_y, p.low_z);
#else
    const vec3 low = vec3(0.0);
#endif
    vec3 from_camera = (vec3(p.x, p.y, p.z) - camera.position.xyz) + (low - camera.position_low.xyz);
#endif
    normals[i] = vec4(dot(normal, from_camera) > 0.0 ? -normal : normal, 0.0);
}
