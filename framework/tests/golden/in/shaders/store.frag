#version 460
layout(set = 0, binding = 0, r32ui) uniform writeonly uimage2D Store;
layout(location = 0) out vec4 color;
void main() { color = vec4(1); imageStore(Store, ivec2(0), uvec4(1)); }
