#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D image;
void main() {
    uint i = gl_GlobalInvocationID.x;
    imageStore(image, ivec2(i, 0), vec4(float(keys[i])));
}
