uniform float means[LAYER_COUNT];
uniform float varies[LAYER_COUNT];
uniform sampler2DShadow shadows;
uniform mat3 sun_axes;         // rows: right and up in the shadow maps, towards the sun
uniform vec4 cascades[3];      // scale and offset (x, y) from metres to -1..1, and the size of a texel in metres
uniform vec4 squares[3];       // the map's place in the atlas: centre (x, y) and half its side (x, y)
uniform vec2 sun_depth;        // scale and offset from metres towards the sun to depth
uniform float bias;            // 0 for the ground, which casts no shadow

in vec3 q;
in vec3 normal;
in vec2 uv;
in vec3 albedo;
flat in float layer;
flat in float gloss;

out vec4 result;

float lit_by_sun(vec3 own_normal) {
    vec3 at = sun_axes * q;
    int which = 2;
    vec2 place = vec2(0.0);
    for (int i = 2; i >= 0; i--) {
        vec2 inside = at.xy * cascades[i].x + cascades[i].yz;
        if (max(abs(inside.x), abs(inside.y)) < 0.995) which = i;
    }
    float cosine = dot(own_normal, to_sun);
    float sine = sqrt(max(1.0 - cosine * cosine, 0.0));
    float lift = bias * (2.2 * cascades[which].w * sine + 0.003);
    at += sun_axes * (own_normal * (cosine < 0.0 ? -lift : lift));
    place = at.xy * cascades[which].x + cascades[which].yz;
    if (max(abs(place.x), abs(place.y)) > 0.999) return 1.0;
    vec2 spot = squares[which].xy + place * squares[which].zw;
    return textureLod(shadows, vec3(spot, at.z * sun_depth.x + sun_depth.y), 0.0);
}

void main() {
    float distance_m = length(q);
    vec3 towards = q / distance_m;
    vec3 own_normal = normalize(cross(dFdx(q), dFdy(q)));
    vec3 seen_normal = normalize(gl_FrontFacing == FRONT_IS_OUTSIDE ? normal : -normal);
    vec2 along = dFdx(uv) * side;
    vec2 across = dFdy(uv) * side;
    float facing = abs(dot(own_normal, towards));
    float level = level_of_detail(abs(along.x * across.y - along.y * across.x), facing);
    int index = int(layer + 0.5);
    vec3 base = albedo * texel(uv, layer, level);
#if VARIED
    float look = texel(varied_place(uv), layer, level + log2(VARIED_SCALE)).g;
    base *= 1.0 + varies[index] * (look / means[index] - 1.0);
#endif
    bool leaf = index == LEAF_LAYER;
    float direct = sunlight(seen_normal, leaf);
    vec3 seen = shade(base, seen_normal, towards, gloss, direct, lit_by_sun(own_normal));
    result = vec4(sqrt(exposed(haze(seen, distance_m))), 1.0);
}
