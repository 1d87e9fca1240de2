#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer Needed { uint needed; };
layout(set = 0, binding = 1, std430) readonly buffer List { uint list[]; };
layout(set = 0, binding = 2, rgba8) writeonly uniform image2D image;
void main() {
    uint entry = gl_GlobalInvocationID.x;
    if (entry >= min(needed, ENTRIES)) return;
    uint pixel = list[entry];
    imageStore(image, ivec2(pixel % VIEWPORT_WIDTH, pixel / VIEWPORT_WIDTH), vec4(1.0 / float(SHADE)));
}
