#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer Needed { uint needed; };
layout(set = 0, binding = 1, std430) readonly buffer List { uint list[]; };
layout(set = 0, binding = 2, std430) buffer Total { uint total; };
layout(set = 0, binding = 3, rgba16f) uniform image2D image;
void main() {
    uint entry = gl_GlobalInvocationID.x;
    if (entry >= min(needed, ENTRIES)) return;
    ivec2 at = ivec2(list[entry] % VIEWPORT_WIDTH, list[entry] / VIEWPORT_WIDTH);
    imageStore(image, at, imageLoad(image, at) + 0.25);
    atomicAdd(total, 1u);
}
