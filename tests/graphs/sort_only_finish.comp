#version 460

// Reads the sorted pairs, so that the sort is not culled, and writes the output image that every graph needs.

layout(local_size_x = 1) in;

layout(set = 0, binding = 0, std430) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 1, std430) readonly buffer Values { uint values[]; };
layout(set = 0, binding = 2, rgba32f) writeonly uniform image2D result;

void main() {
    imageStore(result, ivec2(0), vec4(float(keys[0]), float(values[0]), 0.0, 1.0));
}
