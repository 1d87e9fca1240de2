// Projects a Gaussian to an ellipse on the screen. Quads and tiles share these formulas; the passes that include them decide
// which pixels the ellipse may cover, and write their own records.
//
// The rules are those of the published rasteriser (see docs/splatting.md); the formulas are arranged to stay accurate in
// 32-bit floats: see `Ellipse` and `project_covariance`.

#include "stored_splat.glsl"

// Also finds the splats' depths within the picture, if the graph orders splats at each pixel.
#if defined(PIXEL_WINDOW) && PIXEL_WINDOW > 0
#define HAS_PLANE
#endif

// A graph without the parameter draws pinhole views.
#if defined(PROJECTION) && PROJECTION != PROJECTION_PINHOLE
#define HAS_LENS
#endif

// Views that show splats behind the camera cull by the distance, if it is the sort key.
#if defined(HAS_LENS) && PROJECTION != PROJECTION_ORTHOGRAPHIC && defined(KEY_OF) && KEY_OF == KEY_OF_DISTANCE
#define NEAR_BY_DISTANCE
#endif

const float NEAR_PLANE = 0.2;
// Added to both variances on the screen, in square pixels: no splat is narrower than about a pixel.
#if LOW_PASS == LOW_PASS_MIP
const float DILATION = 0.1;
#else
const float DILATION = 0.3;
#endif
// Margin of the bounds, in pixels, so that rounding never drops a pixel that shading would keep.
const float MARGIN = 1.0 / 64.0;

// The minimum logarithm of opacity / alpha floor for computing an extent. Closer to the floor, the logarithm has no correct digit: an
// extent of 0 would drop a wide splat that shading keeps. Beyond the ellipse, shading drops every pixel.
const float LEAST_LOG = 1e-6;

// The largest coordinate of a centre, in pixels. A scene can have larger ones, up to infinity, for which f32 arithmetic has no
// meaning: these splats are dropped.
const float FARTHEST = 9223372036854775808.0;  // 2^63

// The largest semi-axis of one sigma, in pixels. Its square is finite, and such a splat is constant over the picture.
const float LARGEST = 4611686018427387904.0;  // 2^62

#include "exact_fma.glsl"

// Computes a b - c d and compensates the rounding error of one product (Kahan). Otherwise the difference of two nearly
// equal products would have no correct digit.
float difference_of_products(float a, float b, float c, float d) {
    precise float cd = c * d;
    precise float error = exact_fma(-c, d, cd);
    precise float difference = exact_fma(a, b, -cd);
    return difference + error;
}

// The 2D covariance [[xx, xy], [xy, yy]] in square units, low pass not yet added, with its determinant.
//
// A unit is a pixel for splats of up to some ten million pixels. The determinant, a fourth power, overflows soon after. For larger
// splats a unit is more pixels, by a power of two, so rounding is unaffected.
struct Ellipse {
    float xx, xy, yy;
    float determinant;
    int unit_exponent;
#ifdef HAS_PLANE
    vec2 with_depth;  // covariances of the position on the screen and the depth
#endif
};

// Returns the binary logarithm of a non-negative float, rounded down; -127 for 0.
int exponent_of(float x) {
    return (floatBitsToInt(x) >> 23) - 127;
}

float power_of_two(int exponent) {
    return intBitsToFloat((127 + exponent) << 23);
}

// Returns the exponent of the unit for splats of about 2^`size` pixels.
int unit_exponent_for(int size) {
    return size > 24 ? min(size, 62) : 0;
}

float largest(vec3 v) {
    return max(max(abs(v.x), abs(v.y)), abs(v.z));
}

// Projects the covariance of splat `i`. The rows of J W (Jacobian times rotation to the camera) are `t0` and `t1`; `t2` is the
// derivative of the depth.
//
// The covariance is a factor times its transpose, and so is the ellipse, A A^T with A = J W times that factor. By Lagrange's
// identity its determinant is the squared length of the cross product of A's rows, in which nothing large cancels.
Ellipse project_covariance(uint i, vec3 t0, vec3 t1, vec3 t2) {
    int size = exponent_of(max(largest(t0), largest(t1)));
    mat3 columns = factor_for(i, t0, t1, t2);
    size += exponent_of(max(max(largest(columns[0]), largest(columns[1])), largest(columns[2])));
    Ellipse e;
    e.unit_exponent = unit_exponent_for(size);
    t0 *= power_of_two(-e.unit_exponent);
    t1 *= power_of_two(-e.unit_exponent);
    vec3 a0 = t0 * columns;
    vec3 a1 = t1 * columns;
    e.xx = dot(a0, a0);
    e.xy = dot(a0, a1);
    e.yy = dot(a1, a1);
    vec3 n = vec3(difference_of_products(a0.y, a1.z, a0.z, a1.y),
                  difference_of_products(a0.z, a1.x, a0.x, a1.z),
                  difference_of_products(a0.x, a1.y, a0.y, a1.x));
    e.determinant = dot(n, n);
#ifdef HAS_PLANE
    vec3 a2 = t2 * columns;
    e.with_depth = vec2(dot(a0, a2), dot(a1, a2));
#endif
    return e;
}

#ifdef HAS_LENS
#include "lens.glsl"
#endif

// Returns true if a pixel centre of 0 .. size - 1 is within `reach` of `centre`.
bool covers_a_pixel(float centre, float reach, float size) {
    return max(ceil(centre - reach), 0.0) <= min(floor(centre + reach), size - 1.0);
}

// Returns the unit vector along `v`, even if the squares of its elements overflow or underflow. `v` is not 0.
vec3 direction_of(vec3 v) {
    return normalize(v / largest(v));
}

// A splat in the picture, in pixels with pixel centres at integers.
struct Projection {
    float depth;        // the order's key: view z, or the distance from the camera
    float alpha;        // opacity at the centre
    vec2 centre;
    vec2 bounds;        // half width and half height of the ellipse at the alpha floor
    float reach;        // sigmas from the centre to the alpha floor
    float unit;         // pixels per unit of length of all that follows
    float xx, xy, yy;   // the covariance, low pass included
    float determinant;  // its determinant
    float larger, smaller;  // its eigenvalues
    vec2 direction;     // unit eigenvector of the larger one
    vec3 from_camera;   // from the camera to the splat, in the world
#ifdef HAS_PLANE
    vec3 plane;         // depth at the centre, and its change per pixel to the right and down
#endif
};

// Projects splat `i`; returns false if it is behind the near plane, not above the alpha floor, without area, culled, or not a number.
bool project_splat(uint i, out Projection splat) {
    vec3 p = position_of(i);
    mat4 view = camera.view;

#ifndef HAS_LOW
    // The depth for culling and order. The exact expression matters, because its rounding defines the order of the
    // splats.
    precise float depth = exact_fma(view[2][2], p.z, exact_fma(view[1][2], p.y, view[0][2] * p.x)) + view[3][2];
    splat.depth = depth;
#ifndef NEAR_BY_DISTANCE
    if (!(depth > NEAR_PLANE)) {
        return false;
    }
#endif
#endif
    // At the floor itself, only a pixel exactly at the centre would reach it.
    float alpha = opacity_of(i);
    if (!(alpha > alpha_floor)) {
        return false;
    }
    // The position in camera space, from a difference that is exact near the origin, wherever the origin is in the world: the
    // translation of `view` is rounded like a number as large as the distance from the world's origin.
#ifdef HAS_LOW
    vec3 low = vec3(position[i].low_x, position[i].low_y, position[i].low_z);
    precise vec3 d = (p - camera.origin.xyz) + (low - camera.origin_low.xyz);
#else
    precise vec3 d = (p - camera.origin.xyz) - camera.origin_low.xyz;
#endif
    vec3 from_camera = d + camera.to_origin.xyz;
    float x = fma(view[2][0], d.z, fma(view[1][0], d.y, view[0][0] * d.x)) + camera.view_origin.x;
    float y = fma(view[2][1], d.z, fma(view[1][1], d.y, view[0][1] * d.x)) + camera.view_origin.y;
    float z = fma(view[2][2], d.z, fma(view[1][2], d.y, view[0][2] * d.x)) + camera.view_origin.z;
#ifdef HAS_LOW
    // In floats, the published expression has no correct digits for such a position.
    splat.depth = z;
#ifndef NEAR_BY_DISTANCE
    if (!(z > NEAR_PLANE)) {
        return false;
    }
#endif
#endif

#ifdef HAS_LENS
    ImagePoint point = project_point(vec3(x, y, z));
    if (CULL_MARGIN < 1.0 && any(greaterThan(abs(point.from_axis + camera.principal.xy), (0.5 + CULL_MARGIN) * camera.viewport.xy))) {
        return false;
    }
    // Rows of J W.
    mat3 rotation = mat3(view);
    vec3 t0 = point.j0 * rotation;
    vec3 t1 = point.j1 * rotation;
#else
    // Rows of J W. J is the derivative of (fx x / z, fy y / z), with x / z and y / z clamped to a margin around the picture. The margin
    // does not depend on the principal point.
    vec2 slope = vec2(x, y) / z;
    // Culls by the centre alone, whatever the splat's size.
    if (CULL_MARGIN < 1.0 && any(greaterThan(abs(slope + camera.principal.zw), (1.0 + 2.0 * CULL_MARGIN) * camera.focal.zw))) {
        return false;
    }
    vec2 limit = jacobian_limit * camera.focal.zw;
    vec2 held = clamp(slope, -limit - camera.principal.zw, limit - camera.principal.zw);
    vec3 w0 = vec3(view[0][0], view[1][0], view[2][0]);
    vec3 w1 = vec3(view[0][1], view[1][1], view[2][1]);
    vec3 w2 = vec3(view[0][2], view[1][2], view[2][2]);
    vec3 t0 = (camera.focal.x / z) * (w0 - held.x * w2);
    vec3 t1 = (camera.focal.y / z) * (w1 - held.y * w2);
#endif
    // The derivative of the depth.
#if defined(KEY_OF) && KEY_OF == KEY_OF_DISTANCE
    vec3 t2 = direction_of(from_camera);
#else
    vec3 t2 = vec3(view[0][2], view[1][2], view[2][2]);
#endif
    Ellipse e = project_covariance(i, t0, t1, t2);

    // Eigenvalues: the larger as a sum of positive terms, the smaller as determinant / larger. The low pass adds a constant
    // to both, and only positive terms to the determinant.
    float unit = power_of_two(e.unit_exponent);
    float units_per_pixel = power_of_two(-e.unit_exponent);
#if LOW_PASS == LOW_PASS_NONE
    float low_pass = 0.0;
#else
    float low_pass = DILATION * (units_per_pixel * units_per_pixel);
#endif
    float mean = 0.5 * (e.xx + e.yy);
    float lean = 0.5 * (e.xx - e.yy);
    float radius = length(vec2(lean, e.xy));
    float larger = mean + radius + low_pass;
    float determinant = e.determinant + low_pass * (2.0 * mean + low_pass);
    float smaller = determinant / larger;
    if (!(smaller > 0.0) || isinf(larger)) {
        return false;  // no area, or not a number
    }
    // The eigenvector of the larger one, in the form without cancellation. A circle has none; any direction is right.
    vec2 direction = lean >= 0.0 ? vec2(radius + lean, e.xy) : vec2(e.xy, radius - lean);
    direction = radius > 1e-7 * larger ? normalize(direction) : vec2(1.0, 0.0);

    // Clamped only here: above, `larger` must agree with `radius`.
    float most = LARGEST * units_per_pixel;
    larger = min(larger, most * most);
    smaller = min(smaller, most * most);

#if LOW_PASS == LOW_PASS_COMPENSATED || LOW_PASS == LOW_PASS_MIP
    // The dilated ellipse has the volume of the sharp one (Yu et al. 2024, "Mip-Splatting", 2D Mip filter).
    alpha *= sqrt(e.determinant / determinant);
    if (!(alpha > alpha_floor)) {
        return false;
    }
#endif

#ifdef HAS_LENS
    splat.centre = point.from_axis + (0.5 * (camera.viewport.xy - 1.0) + camera.principal.xy);
#else
    splat.centre = camera.focal.xy * slope + (0.5 * (camera.viewport.xy - 1.0) + camera.principal.xy);
#endif
    splat.alpha = alpha;
    splat.reach = sqrt(2.0 * max(log(alpha / alpha_floor), LEAST_LOG));
    splat.unit = unit;
    splat.xx = e.xx + low_pass;
    splat.xy = e.xy;
    splat.yy = e.yy + low_pass;
    splat.determinant = determinant;
    splat.larger = larger;
    splat.smaller = smaller;
    splat.direction = direction;
    splat.bounds = splat.reach * (sqrt(vec2(splat.xx, splat.yy)) * unit);
    splat.from_camera = from_camera;
#ifdef KEY_OF  // a graph without the parameter sorts by depth
#if KEY_OF == KEY_OF_DISTANCE
    // Scaled by powers of two, so that squares neither overflow nor underflow.
    int size = clamp(exponent_of(largest(from_camera)), -120, 120);
    splat.depth = length(from_camera * power_of_two(-size)) * power_of_two(size);
#ifdef NEAR_BY_DISTANCE
    if (!(splat.depth > NEAR_PLANE)) {
        return false;
    }
#endif
#endif
#endif
#ifdef HAS_PLANE
    // At given x and y, the mean depth of a Gaussian is linear in them: the slope is the inverse covariance, in the triangular form of
    // record.glsl, times the covariances with the depth.
    float lean_of_row = splat.xy / splat.yy;
    float width = sqrt(splat.yy / splat.determinant);
    float p0 = width * (e.with_depth.x - lean_of_row * e.with_depth.y);
    float p1 = e.with_depth.y / splat.yy;
    splat.plane = vec3(splat.depth, vec2(width * p0, p1 - width * lean_of_row * p0) * units_per_pixel);
#endif
    return largest(vec3(splat.centre, 0.0)) <= FARTHEST;
}

// The maximum brightness of a splat in an f32 picture. A scene can have larger ones, up to infinity: such splats are dimmed. A
// sum of alpha times brightness, rounded at each splat, stays below twice the brightness.
const float BRIGHTEST_FLOAT = 1e30;
const float BRIGHTEST_HALF = 32752.0;  // half of the largest half float

// Evaluates the colour of splat `i`, seen along `from_camera`: display-encoded r, g, b in 0 .. `brightest`.
vec3 finite_colour(uint i, vec3 from_camera, float brightest) {
    vec3 colour = sh_colour(i, direction_of(from_camera));
    // These comparisons are false for NaN, which coefficients near the f32 maximum produce.
    return vec3(colour.r > 0.0 ? min(colour.r, brightest) : 0.0,
                colour.g > 0.0 ? min(colour.g, brightest) : 0.0,
                colour.b > 0.0 ? min(colour.b, brightest) : 0.0);
}
