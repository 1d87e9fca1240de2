#version 460
#extension GL_GOOGLE_include_directive : require

// Projects Gaussians to quads on the screen: cull, project, colour. Each invocation takes one splat. A visible splat
// gets a record and its depth at its own index, an invisible one the depth -1.

#include "camera.glsl"
#include "groups.glsl"
#include "live.glsl"
#include "splat.glsl"
#include "spherical_harmonics.glsl"
#include "projection.glsl"

layout(set = 0, binding = 3, std430) writeonly buffer Splats { Splat splats[]; };
layout(set = 0, binding = 6, std430) writeonly buffer Colours { vec4 colours[]; };

#if TARGET == TARGET_RGBA16F
const float BRIGHTEST = BRIGHTEST_HALF;
#else
const float BRIGHTEST = BRIGHTEST_FLOAT;
#endif

// Projects splat `i`, and writes its record if it is visible. Returns the depth that orders it, or -1 if it is not visible.
float project(uint i) {
    Projection p;
    if (!project_splat(i, p)) {
        return -1.0;
    }
    // The quad extends to the alpha floor, or to the cutoff.
    Splat splat;
    splat.centre = p.centre;
    splat.major = sqrt(p.larger) * p.unit * p.direction;
    splat.minor = sqrt(p.smaller) * p.unit * vec2(-p.direction.y, p.direction.x);
    splat.extent = min(cutoff, p.reach);
    splat.opacity = p.alpha;

    // The smaller of the quad's bounds and the ellipse's at the alpha floor.
    vec2 quad = splat.extent * (abs(splat.major) + abs(splat.minor));
    vec2 bounds = min(quad, p.bounds) + MARGIN;
    if (!covers_a_pixel(p.centre.x, bounds.x, camera.viewport.x)
        || !covers_a_pixel(p.centre.y, bounds.y, camera.viewport.y)) {
        return -1.0;
    }
    splats[i] = splat;
    colours[i] = vec4(finite_colour(i, p.from_camera, BRIGHTEST), 0.0);
    return p.depth;
}

// Leaves a record that draws nothing, for a splat drawn because it was visible in the previous frame.
void leave_out(uint i) {
#if ORDER_OF == ORDER_OF_LAST_FRAME
    splats[i] = Splat(vec2(0.0), vec2(1.0, 0.0), vec2(0.0, 1.0), 0.0, 0.0);
    colours[i] = vec4(0.0);
#endif
}

#include "project_all.glsl"

void main() {
    project_all();
}
