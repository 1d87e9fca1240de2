#version 460
#extension GL_GOOGLE_include_directive : require

// Projects Gaussians to quads on the screen: cull, project, colour. Each invocation takes one splat. A visible splat
// gets a record and its depth at its own index, an invisible one the depth -1. Every workgroup counts its visible splats,
// so that compact.comp can close the gaps and keep the order of the indices.

#include "camera.glsl"
#include "groups.glsl"
#include "live.glsl"
#include "splat.glsl"
#include "spherical_harmonics.glsl"
#include "projection.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 3, std430) writeonly buffer Splats { Splat splats[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Depth { float depth_of[]; };
layout(set = 0, binding = 5, std430) writeonly buffer BlockCount { uint block_count[]; };

#if TARGET == TARGET_RGBA16F
const float BRIGHTEST = BRIGHTEST_HALF;
#else
const float BRIGHTEST = BRIGHTEST_FLOAT;
#endif

// The number of visible splats in the workgroup. It is counted without ballots: invocations leave `project` at different
// places, and nothing says that a subgroup is whole again after that.
shared uint visible_count;

#if ORDER_OF == ORDER_OF_LAST_FRAME
// The record of an invisible splat, which is drawn if it was visible in the previous frame.
const Splat NOTHING = Splat(vec2(0.0), vec2(1.0, 0.0), vec2(0.0, 1.0), 0.0, 0.0, vec4(0.0));
#endif

// Projects splat `i`, writes its record if it is visible, and returns its view depth, or -1 if it is not.
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

    // The smaller of the bounds of the quad and of the ellipse at the alpha floor.
    vec2 quad = splat.extent * (abs(splat.major) + abs(splat.minor));
    vec2 bounds = min(quad, p.bounds) + MARGIN;
    if (!covers_a_pixel(p.centre.x, bounds.x, camera.viewport.x)
        || !covers_a_pixel(p.centre.y, bounds.y, camera.viewport.y)) {
        return -1.0;
    }
    splat.colour = vec4(finite_colour(i, p.from_camera, BRIGHTEST), 0.0);
    splats[i] = splat;
    return p.depth;
}

void main() {
    uint group = group_index();
    uint i = group * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (gl_LocalInvocationIndex == 0u) {
        visible_count = 0u;
    }
    barrier();

    float z = -1.0;
    if (i < uint(SCENE_COUNT)) {
        z = project(i);
        depth_of[i] = z;
#if ORDER_OF == ORDER_OF_LAST_FRAME
        if (!(z > 0.0)) {
            splats[i] = NOTHING;
        }
#endif
    }
    if (z > 0.0) {
        atomicAdd(visible_count, 1u);
    }
    barrier();
    if (gl_LocalInvocationIndex == 0u && group * gl_WorkGroupSize.x < uint(SCENE_COUNT)) {
        block_count[group] = visible_count;
    }
}
