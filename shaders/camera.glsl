// The camera of a frame, 256 bytes from the host. The conventions are those of the reference rasteriser: camera space
// has x to the right, y down and z forward; pixel centres are at integers.
#ifndef CAMERA_GLSL
#define CAMERA_GLSL
layout(set = 0, binding = 30, std140) uniform Camera {
    mat4 view;        // world to camera, column-major
    vec4 position;    // the camera's centre in world space, rounded to f32; w unused
    vec4 focal;       // fx, fy in pixels; tan(fov_x / 2), tan(fov_y / 2)
    vec4 viewport;    // width, height in pixels; 1 / width, 1 / height
    vec4 depth;       // near plane; least and greatest view z of the scene's bounding box; its greatest distance
    vec4 background;  // r, g, b, display-encoded; w unused
    vec4 position_low; // the rest of `position`, which f32 cannot hold; w unused
    uint frame;       // number of the frame, from 0
    // Positions in camera space are computed relative to this world point: the camera, or for a telephoto view of a distant
    // scene a point on the camera's axis in the middle of the scene. w unused.
    vec4 origin;      // rounded to f32
    vec4 origin_low;  // the rest, which f32 cannot hold
    vec4 to_origin;   // from the camera to `origin`, in world space
    vec4 view_origin; // from the camera to `origin`, in camera space
    vec4 principal;   // the principal point from the middle of the picture: in pixels, and over the focal lengths
} camera;
#endif
