// The surface of a mesh behind the splats of a pixel: its colour, which takes the place of the background, and its depth (the distance
// where splats are ordered by it), at which the splats end. The image has a depth of 0 where there is no mesh.

#if WITH_MESH
layout(set = 0, binding = 20, rgba32f) readonly uniform image2D surface;

const float NO_SURFACE = 3.4028234e38;

// Returns the depth of the mesh; NO_SURFACE without one. Pixels beyond the picture get the depth at its edge.
float surface_depth(uvec2 pixel) {
    float depth = imageLoad(surface, ivec2(min(pixel, uvec2(VIEWPORT_WIDTH, VIEWPORT_HEIGHT) - 1u))).a;
    return depth > 0.0 ? depth : NO_SURFACE;
}

vec3 behind_splats(uvec2 pixel, vec3 background) {
    vec4 found = imageLoad(surface, ivec2(pixel));
    return found.a > 0.0 ? found.rgb : background;
}

#define BEHIND(pixel, background) behind_splats(pixel, background)
#else
#define BEHIND(pixel, background) background
#endif
