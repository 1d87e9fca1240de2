#version 460
layout(set = 0, binding = 0, rgba16f) uniform readonly image2D From;
layout(set = 0, binding = 1, rgba16f) uniform writeonly image2D To;
void main() { imageStore(To, ivec2(0), imageLoad(From, ivec2(0))); }
