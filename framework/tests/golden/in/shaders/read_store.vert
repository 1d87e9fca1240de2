#version 460
layout(set = 0, binding = 0, r32ui) uniform readonly uimage2D Store;
void main() { gl_Position = vec4(imageLoad(Store, ivec2(0))); }
