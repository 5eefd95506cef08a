uniform mat3 ray_from_clip;
in vec2 corner;
out vec3 ray;

void main() {
    ray = ray_from_clip * vec3(corner, 1.0);
    gl_Position = vec4(corner, 1.0, 1.0);
}
