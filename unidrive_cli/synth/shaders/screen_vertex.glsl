uniform float level;
in vec2 corner;

void main() {
    gl_Position = vec4(corner, level, 1.0);
}
