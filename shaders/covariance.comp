#version 460
#extension GL_GOOGLE_include_directive : require

// Computes the 3D covariance of every splat, R S S^T R^T, from its scale and rotation. It does not depend on the camera,
// so this pass runs once per scene.
//
// All forms are factors; the covariance is computed from them as a sum of squares. A rounded covariance itself would lose
// the short axis of a needle with an axis ratio above 2^12.
//
// `factored` stores M = R S, 36 bytes: the covariance is M M^T. `six` stores the lower triangle of L, 24 bytes, with
// L L^T = M M^T (Cholesky). Its elements come from minors of M, in which nothing cancels: by Lagrange's identity the
// elimination's differences are cross products of rows of M, and these are rows of R times two of the scales. `half` has the
// same six elements in half floats, 12 bytes.

#include "groups.glsl"
#include "rotation.glsl"

layout(local_size_x = 256) in;

struct Scale3 { float x, y, z; };
#if COVARIANCE == COVARIANCE_FACTORED
struct Covariance3 { float m[9]; };  // row by row
#else
struct Covariance3 { float l00, l10, l20, l11, l21, l22; };
#endif
#if COVARIANCE == COVARIANCE_HALF
struct Stored { uint l00_l10, l20_l11, l21_l22; };
#else
#define Stored Covariance3
#endif

layout(set = 0, binding = 0, std430) readonly buffer Scale { Scale3 scale[]; };
layout(set = 0, binding = 1, std430) readonly buffer Rotation { vec4 rotation[]; };  // w, x, y, z
layout(set = 0, binding = 2, std430) writeonly buffer Covariance { Stored covariance[]; };

// Maximum scale; larger ones are clamped to it, because their squares could overflow a float.
const float LARGEST = 1e18;

#if COVARIANCE != COVARIANCE_FACTORED
float largest(vec3 v) {
    return max(max(abs(v.x), abs(v.y)), abs(v.z));
}

float with_sign(float x, bool negative) {
    return uintBitsToFloat(floatBitsToUint(x) | (negative ? 0x80000000u : 0u));
}

// Computes the triangle. Row 0 of L belongs to the longest row of M, so that a needle's length is in column 0 and its width
// in the others; the other rows follow cyclically. The diagonal is not negative, so its signs can encode which row is first.
Covariance3 triangle(mat3 r, vec3 s) {
    float unit = max(s.x, max(s.y, s.z));
    if (!(unit > 0.0)) {
        return Covariance3(0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    }
    s /= unit;
    vec3 lengths = vec3(length(r[0] * s), length(r[1] * s), length(r[2] * s));
    int first = lengths.y > lengths.x ? 1 : 0;
    first = lengths.z > lengths[first] ? 2 : first;
    vec3 r0 = r[first], r1 = r[(first + 1) % 3], r2 = r[(first + 2) % 3];
    vec3 m0 = r0 * s, m1 = r1 * s, m2 = r2 * s;

    // The cross products of row 0 with row 1 and row 2.
    vec3 pairs = s.yzx * s.zxy;
    vec3 n1 = r2 * pairs;
    vec3 n2 = -r1 * pairs;
    float scale = largest(n1);
    float across = length(n1 / max(scale, 1e-37));
    Covariance3 c;
    c.l00 = lengths[first];
    c.l10 = dot(m1, m0) / c.l00;
    c.l20 = dot(m2, m0) / c.l00;
    c.l11 = 0.0;
    c.l21 = 0.0;
    c.l22 = 0.0;
    if (scale >= 1e-37) {
        c.l11 = across * scale / c.l00;
        c.l21 = dot(n1 / scale, n2) / (across * c.l00);
        c.l22 = s.x * s.y * s.z / scale / across;
    }
    c.l00 = with_sign(c.l00 * unit, first == 1);
    c.l10 *= unit;
    c.l20 *= unit;
    c.l11 = with_sign(c.l11 * unit, first == 2);
    c.l21 *= unit;
    c.l22 *= unit;
    return c;
}
#endif

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i >= uint(SCENE_COUNT)) {
        return;
    }

    // The quaternion was normalised when the scene was loaded.
    mat3 r = rows_of_rotation(rotation[i]);
    vec3 s = min(vec3(scale[i].x, scale[i].y, scale[i].z), LARGEST);

#if COVARIANCE == COVARIANCE_FACTORED
    for (int row = 0; row < 3; row++) {
        covariance[i].m[3 * row] = r[row].x * s.x;
        covariance[i].m[3 * row + 1] = r[row].y * s.y;
        covariance[i].m[3 * row + 2] = r[row].z * s.z;
    }
#else
    Covariance3 c = triangle(r, s);
#if COVARIANCE == COVARIANCE_HALF
    // The largest half float. Converting a larger value is undefined.
    const float MOST = 65504.0;
    covariance[i] = Stored(packHalf2x16(clamp(vec2(c.l00, c.l10), -MOST, MOST)),
                           packHalf2x16(clamp(vec2(c.l20, c.l11), -MOST, MOST)),
                           packHalf2x16(clamp(vec2(c.l21, c.l22), -MOST, MOST)));
#else
    covariance[i] = c;
#endif
#endif
}
