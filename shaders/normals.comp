#version 460
#extension GL_GOOGLE_include_directive : require

// Finds the normal of every splat: its shortest axis in world space, facing the camera; of equally short axes, the first.

#include "camera.glsl"
#include "groups.glsl"

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
    // The columns of the rotation (see covariance.comp) are the axes.
    vec4 q = rotation[i];
    float w = q.x, x = q.y, y = q.z, z = q.w;
    Vector3 s = scale[i];
    vec3 normal = vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));
    float shortest = s.x;
    if (s.y < shortest) {
        normal = vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
        shortest = s.y;
    }
    if (s.z < shortest) {
        normal = vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
    }
    Position3 p = position[i];
#if SCENE_WIDE
    vec3 low = vec3(p.low_x, p.low_y, p.low_z);
#else
    const vec3 low = vec3(0.0);
#endif
    vec3 from_camera = (vec3(p.x, p.y, p.z) - camera.position.xyz) + (low - camera.position_low.xyz);
    normals[i] = vec4(dot(normal, from_camera) > 0.0 ? -normal : normal, 0.0);
}
