#version 460
layout(set = 0, binding = 0, std430) buffer Header { uint words[64]; uint rest[]; };
void main() { rest[0] = words[0]; }
