#version 460
layout(location = 0) in vec2 tone;
layout(location = 1) in float depth;
layout(location = 0) out vec4 color;
void main() { color = vec4(tone, depth, 1); }
