in vec3 ray;
out vec4 result;

void main() {
    vec3 towards = normalize(ray);
    vec2 place = cloud_place(towards);
    vec2 along = dFdx(place) * side;
    vec2 across = dFdy(place) * side;
    float level = level_of_detail(abs(along.x * across.y - along.y * across.x), 1.0);
    float density = texel(place, float(CLOUD_LAYER), level).g;
    result = vec4(sqrt(exposed(sky(towards, density))), 1.0);
}
