// A projected splat, written by project.comp for splat.vert. Its colour is in a buffer of its own (display-encoded r, g, b, not
// below 0; w unused), because the smallest devices limit storage buffers to 128 MiB.
#ifndef SPLAT_GLSL
#define SPLAT_GLSL
struct Splat {
    vec2 centre;      // in pixels, pixel centres at integers
    vec2 major;       // half axis of the ellipse of one sigma, in pixels
    vec2 minor;       // the other one, perpendicular to it
    float extent;     // sigmas from the centre to the edge of the quad
    float opacity;
};
#endif
