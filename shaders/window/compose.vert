#version 460

// Makes one triangle that covers the window.

void main() {
    vec2 corner = vec2(float(gl_VertexIndex & 1), float(gl_VertexIndex >> 1));
    gl_Position = vec4(4.0 * corner - 1.0, 0.0, 1.0);
}
