#version 460

// Writes one vector of the copy to the graph's output image, so that the copy is not culled.

layout(local_size_x = 1) in;

layout(set = 0, binding = 0, std430) readonly buffer To { uvec4 to[]; };
layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D result;

void main() {
    imageStore(result, ivec2(0), vec4(to[0]));
}
