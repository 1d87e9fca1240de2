#version 460
#extension GL_GOOGLE_include_directive : require

// Makes a splat's quad, a rectangle along the axes of its ellipse. The corners only select the pixels; the fragment shader
// measures from the centre, because the rasteriser snaps corners, to 1/256 pixel on most devices, and interpolated
// coordinates would have the same error.

#include "args.glsl"
#include "camera.glsl"
#include "splat.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, std430) readonly buffer Splats { Splat splats[]; };
layout(set = 0, binding = 3, std430) readonly buffer Colours { vec4 colours[]; };

#if WITH_OUTPUTS || WITH_MESH
layout(set = 0, binding = 4, std430) readonly buffer Depth { float depth_of[]; };
#endif

layout(location = 0) flat out vec2 centre;
layout(location = 1) flat out vec4 inverse_axes;
layout(location = 2) flat out vec4 colour;
#if WITH_OUTPUTS
layout(location = 3) flat out float depth;
#endif

// Margin in pixels on every side, so that snapping loses no pixel. A device snaps to at least 1/16 pixel.
const float MARGIN = 1.0 / 16.0;

void main() {
    uint rank = uint(gl_InstanceIndex);
#if BLEND == BLEND_BACK_TO_FRONT
    rank = args[ARGS_DRAWN] - 1u - rank;
#endif
    uint index = order[rank];
    Splat splat = splats[index];

    float major2 = dot(splat.major, splat.major);
    float minor2 = dot(splat.minor, splat.minor);
    vec2 corner = vec2(float(gl_VertexIndex & 1), float(gl_VertexIndex >> 1)) * 2.0 - 1.0;
    // Clamped to the distance of the farthest pixel: corners of a quad far larger than the picture have no exact position.
    vec2 farthest = max(abs(splat.centre), abs(camera.viewport.xy - splat.centre));
    vec2 per_pixel = inversesqrt(vec2(major2, minor2));
    corner *= min(splat.extent + MARGIN * per_pixel, (length(farthest) + 2.0) * per_pixel);
    vec2 pixel = splat.centre + corner.x * splat.major + corner.y * splat.minor;

    // Pixel centres are at integers here, at halves in the framebuffer.
    gl_Position = vec4((2.0 * pixel + 1.0) * camera.viewport.zw - 1.0, 0.0, 1.0);
#if WITH_MESH
    // The reversed depth of the centre (mesh/mesh.vert): all of the splat is before or behind the mesh where its centre is.
    gl_Position.z = camera.depth.x / depth_of[index];
#endif
    centre = splat.centre;
    inverse_axes = vec4(splat.major / major2, splat.minor / minor2);
    colour = vec4(colours[index].rgb, splat.opacity);
#if WITH_OUTPUTS
    depth = depth_of[index];
#endif
}
