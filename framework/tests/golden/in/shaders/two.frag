#version 460
layout(location = 0) out vec4 color;
layout(location = 1) out vec4 other;
void main() { color = vec4(1); other = vec4(2); }
