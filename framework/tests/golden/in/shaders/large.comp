#version 460
layout(local_size_x = 1024) in;
layout(set = 0, binding = 0, std430) writeonly buffer Out { uint o[]; };
shared uint table[10000];
void main() { table[gl_LocalInvocationIndex] = 1; o[0] = table[0]; }
