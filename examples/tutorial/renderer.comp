#version 460
#extension GL_GOOGLE_include_directive : require

// Projects the splats to ellipses on the screen, with the colours that the camera sees.

#include "camera.glsl"
#include "groups.glsl"
#include "live.glsl"
#include "splat.glsl"
#include "spherical_harmonics.glsl"
#include "projection.glsl"

layout(set = 0, binding = 3, std430) writeonly buffer Splats { Splat splats[]; };
layout(set = 0, binding = 6, std430) writeonly buffer Colours { vec4 colours[]; };

// Writes the record of splat `i` and returns its depth; -1 if it is not in view.
float project(uint i) {
    Projection p;
    if (!project_splat(i, p)) {
        return -1.0;
    }
    vec2 major = sqrt(p.larger) * p.unit * p.direction;
    vec2 minor = sqrt(p.smaller) * p.unit * vec2(-p.direction.y, p.direction.x);
    splats[i] = Splat(p.centre, major, minor, p.reach, p.alpha);
#if SHADE == SHADE_DEPTH
    // White at the nearest end of the scene, black at the farthest.
    vec3 colour = vec3((camera.depth.z - p.depth) / (camera.depth.z - camera.depth.y));
#else
    vec3 colour = finite_colour(i, p.from_camera, BRIGHTEST_FLOAT);
#endif
    colours[i] = vec4(colour, 0.0);
    return p.depth;
}

// A splat that is not in view has an ellipse without extent.
void leave_out(uint i) {
    splats[i] = Splat(vec2(0.0), vec2(1.0, 0.0), vec2(0.0, 1.0), 0.0, 0.0);
}

// Calls these functions for all splats, and counts the visible ones for the sort.
#include "project_all.glsl"

void main() {
    project_all();
}
