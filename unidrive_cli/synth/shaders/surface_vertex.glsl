// q is the place relative to the camera along the global axes; the offset comes in two parts, so that a scene
// hundreds of metres from its origin keeps its micrometres near the camera.
uniform mat3 turn;
uniform vec3 offset_high;
uniform vec3 offset_low;
uniform mat4 clip_from_q;

in vec3 position;
in vec3 normal_mesh;
in vec2 texture_place;
in vec3 colour;
in float layer_index;
in float shine;

out vec3 q;
out vec3 normal;
out vec2 uv;
out vec3 albedo;
flat out float layer;
flat out float gloss;

invariant gl_Position;  // the depth pass and the shading pass must agree to the last bit

void main() {
    q = (turn * position + offset_high) + offset_low;
    normal = turn * normal_mesh;
    uv = texture_place;
    albedo = colour;
    layer = layer_index;
    gloss = shine;
    gl_Position = clip_from_q * vec4(q, 1.0);
}
