#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer In { uint i[]; };
layout(set = 0, binding = 1, rgba16f) uniform writeonly image2D Image;
void main() { imageStore(Image, ivec2(gl_LocalInvocationIndex % 8, gl_LocalInvocationIndex / 8), vec4(i[0])); }
