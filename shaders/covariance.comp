#version 460
#extension GL_GOOGLE_include_directive : require

// Computes the 3D covariance of every splat, R S S^T R^T, from its scale and rotation. It does not depend on the camera,
// so this pass runs once per scene.
//
// `six` stores the six different elements of the symmetric matrix, 24 bytes. `factored` stores M = R S, 36 bytes: the
// covariance is M M^T, and a computation from M keeps the short axis of a needle, which rounding of the product loses if
// the axes differ by more than 2^12 to 1.

#include "groups.glsl"

layout(local_size_x = 256) in;

struct Scale3 { float x, y, z; };
#if COVARIANCE == COVARIANCE_FACTORED
struct Covariance3 { float m[9]; };  // row by row
#else
struct Covariance3 { float xx, xy, xz, yy, yz, zz; };
#endif

layout(set = 0, binding = 0, std430) readonly buffer Scale { Scale3 scale[]; };
layout(set = 0, binding = 1, std430) readonly buffer Rotation { vec4 rotation[]; };  // w, x, y, z
layout(set = 0, binding = 2, std430) writeonly buffer Covariance { Covariance3 covariance[]; };

// Larger scales are drawn like this one, which is beyond all that a picture shows: their squares are no floats.
const float LARGEST = 1e18;

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i >= uint(SCENE_COUNT)) {
        return;
    }

    // The quaternion was normalised when the scene was loaded, and is not normalised again.
    vec4 q = rotation[i];
    float w = q.x, x = q.y, y = q.z, z = q.w;
    vec3 s = min(vec3(scale[i].x, scale[i].y, scale[i].z), LARGEST);

    // The rows of M = R S.
    vec3 row0 = vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)) * s;
    vec3 row1 = vec3(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)) * s;
    vec3 row2 = vec3(2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)) * s;

#if COVARIANCE == COVARIANCE_FACTORED
    covariance[i].m[0] = row0.x;
    covariance[i].m[1] = row0.y;
    covariance[i].m[2] = row0.z;
    covariance[i].m[3] = row1.x;
    covariance[i].m[4] = row1.y;
    covariance[i].m[5] = row1.z;
    covariance[i].m[6] = row2.x;
    covariance[i].m[7] = row2.y;
    covariance[i].m[8] = row2.z;
#else
    covariance[i].xx = dot(row0, row0);
    covariance[i].xy = dot(row0, row1);
    covariance[i].xz = dot(row0, row2);
    covariance[i].yy = dot(row1, row1);
    covariance[i].yz = dot(row1, row2);
    covariance[i].zz = dot(row2, row2);
#endif
}
