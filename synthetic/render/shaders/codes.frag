#version 330 core
// Little-endian, red first: triangle in the lower 24 bits, body in the upper 8.
uniform float body;
out vec4 code;

void main()
{
    int n = gl_PrimitiveID;
    code = vec4(n & 255, (n >> 8) & 255, (n >> 16) & 255, 0) / 255.0 + vec4(0.0, 0.0, 0.0, body);
}
