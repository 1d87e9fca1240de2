// The projections other than pinhole: where a point in camera space is in the picture, and the derivative there (the Jacobian), from which
// the ellipse of a splat follows. See docs/projections.md. A graph chooses the projection by its parameter `projection`.

// Returns atan(t) / t as a function of t * t, for t from 0 to 1, with a relative error of 1.5e-8. Vulkan allows atan() an error of 4096
// units in the last place, a tenth of a pixel in large pictures.
float arc_ratio(float tt) {
    float p = 0.00284988711 * tt - 0.0160686215;
    p = p * tt + 0.042691512;
    p = p * tt - 0.0750429443;
    p = p * tt + 0.106409343;
    p = p * tt - 0.142036446;
    p = p * tt + 0.199926194;
    p = p * tt - 0.333330733;
    return p * tt + 0.999999985;
}

const float PI = 3.14159265358979;

// Returns the angle of (x, y) from the x axis, for y not below 0: 0 to pi; 0 for the origin.
float angle_of(float y, float x) {
    float less = min(y, abs(x));
    float more = max(y, abs(x));
    float t = less / max(more, 1e-30);
    float angle = t * arc_ratio(t * t);
    angle = y > abs(x) ? 0.5 * PI - angle : angle;
    return x < 0.0 ? PI - angle : angle;
}

// A projected point.
struct ImagePoint {
    vec2 from_axis;  // in pixels, from the principal point
    vec3 j0, j1;     // the derivatives of its x and y by the point in camera space
};

#if PROJECTION == PROJECTION_ORTHOGRAPHIC
ImagePoint project_point(vec3 p) {
    return ImagePoint(camera.focal.xy * p.xy, vec3(camera.focal.x, 0.0, 0.0), vec3(0.0, camera.focal.y, 0.0));
}
#else

// Minimum of the sine of the angle from the axis in the Jacobian of a fisheye camera, beyond 90 degrees. Straight behind the camera, a
// splat covers a ring, which no ellipse approximates.
const float LEAST_SINE = 0.25;
// Minimum of the cosine of the latitude in the Jacobian of an equirectangular camera.
const float LEAST_COSINE = 1e-3;

ImagePoint project_point(vec3 p) {
    // Scales by a power of two, so that squares neither overflow nor underflow. Directions do not change.
    float scale = power_of_two(-clamp(exponent_of(largest(p)), -120, 120));
    p *= scale;
    float square = dot(p, p);
#if PROJECTION == PROJECTION_FISHEYE
    vec2 focal = camera.focal.xy;
    float from_axis = length(p.xy);
    vec2 around = from_axis > 0.0 ? p.xy / from_axis : vec2(1.0, 0.0);
    float angle = angle_of(from_axis, p.z);
    // Pixels per unit of length, over the focal length: outwards, across, and along the axis. On the axis, the first two are equal,
    // so the arbitrary `around` has no effect.
    float t = from_axis / max(p.z, 1e-30);
    float across = t < 1.0 && p.z > 0.0 ? arc_ratio(t * t) / p.z : angle / max(from_axis, LEAST_SINE * sqrt(square));
    float outwards = p.z / square;
    float along = -from_axis / square;
    float mixed = (outwards - across) * around.x * around.y;
    vec3 j0 = vec3(across + (outwards - across) * around.x * around.x, mixed, along * around.x);
    vec3 j1 = vec3(mixed, across + (outwards - across) * around.y * around.y, along * around.y);
    vec2 place = angle * around;
#else
    // The whole sphere: the focal lengths follow from the size of the picture.
    vec2 focal = camera.viewport.xy / vec2(2.0 * PI, PI);
    float from_pole = length(p.xz);
    vec2 around = from_pole > 0.0 ? p.xz / from_pole : vec2(0.0, 1.0);
    float longitude = angle_of(abs(p.x), p.z);
    float latitude = angle_of(abs(p.y), from_pole);
    vec3 j0 = vec3(around.y, 0.0, -around.x) / max(from_pole, LEAST_COSINE * sqrt(square));
    vec3 j1 = vec3(-p.y * around.x, from_pole, -p.y * around.y) / square;
    vec2 place = vec2(p.x < 0.0 ? -longitude : longitude, p.y < 0.0 ? -latitude : latitude);
#endif
    return ImagePoint(focal * place, (focal.x * scale) * j0, (focal.y * scale) * j1);
}
#endif
