uniform float id;
in float depth_m;
out vec2 result;

void main() {
    result = vec2(id, depth_m);
}
