#version 460
layout(set = 0, binding = 0, std430) readonly buffer In { float i[]; };
layout(location = 0) out vec4 tone;
void main() { tone = vec4(i[0]); gl_Position = vec4(i[gl_VertexIndex]); }
