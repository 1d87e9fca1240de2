#version 460
layout(set = 0, binding = 1, rgba16f) uniform readonly image2D From;
layout(location = 0) out vec4 color;
void main() { color = imageLoad(From, ivec2(0)); }
