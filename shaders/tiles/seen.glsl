// The buffers that the tile rasterisers read and write for outputs besides the picture.

#include "../pixels.glsl"

#if WITH_OUTPUTS
layout(set = 0, binding = 10, std430) readonly buffer Depth { float depth_of[]; };
layout(set = 0, binding = 11, std430) buffer Pixels { Pixel pixels[]; };
#if WITH_NORMALS
layout(set = 0, binding = 12, std430) readonly buffer Normals { vec4 normals[]; };
#endif

// Returns splat `index`'s inputs to the output sums.
Seen seen_splat(uint index) {
#if WITH_NORMALS
    return Seen(depth_of[index], index, normals[index].xyz);
#else
    return Seen(depth_of[index], index, vec3(0.0));
#endif
}
#endif
