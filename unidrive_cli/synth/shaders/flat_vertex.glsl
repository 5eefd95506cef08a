uniform mat3 turn;
uniform vec3 offset_high;
uniform vec3 offset_low;
uniform mat4 clip_from_q;
uniform vec3 axis;
in vec3 position;
out float depth_m;

// q is the place relative to the camera along the global axes; the offset comes in two parts, so that a scene
// hundreds of metres from its origin keeps its micrometres near the camera.

void main() {
    vec3 q = (turn * position + offset_high) + offset_low;
    depth_m = dot(axis, q);
    gl_Position = clip_from_q * vec4(q, 1.0);
}
