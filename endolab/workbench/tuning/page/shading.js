// The model's equation for a plane, of each ray of a picture. No DOM here.
/**
 * L = g cos^k′ α cosᵐ ψ / d² f_r cos θ, I = L^(1/γ); d from the lamp, f_r at the half angle of lamp
 * and lens. Returns the factors, L and I as maps, nan where a ray misses the plane.
 * @type {(camera: object, knobs: object, nodes: number[], brdf: number[]) => Float32Array[]}
 */
export function shade({ rays, width, height }, knobs, nodes, brdf) {
  const { k, m, gamma, gain, lamp, tilt, depth } = knobs, size = width * height;
  // The normal's, away from the camera.
  const [across, ahead] = [Math.sin, Math.cos].map((part) => part(tilt * Math.PI / 180));
  const maps = [0, 1, 2, 3, 4, 5].map(() => new Float32Array(size).fill(NaN));
  const [light, fall, f_r, slant, linear, image] = maps;
  const apart = nodes[1] - nodes[0], last = nodes.length - 1;
  for (let p = 0; p < size; p++) {
    const x = rays[3 * p], y = rays[3 * p + 1], z = rays[3 * p + 2];
    const facing = x * across + z * ahead;
    if (!(z > 0 && facing > 0)) continue;
    const distance = depth * ahead / facing;
    const right = distance * x - lamp, down = distance * y, far = distance * z;
    const reach = Math.sqrt(right * right + down * down + far * far);
    const cosine = (right * across + far * ahead) / reach;
    const half = [x + right / reach, y + down / reach, z + far / reach]; // between lamp and lens
    const to_half = (half[0] * across + half[2] * ahead) / Math.hypot(...half);
    const halfway = Math.acos(Math.min(1, Math.max(0, to_half)));
    const place = halfway / apart, node = Math.min(last - 1, Math.floor(place));
    light[p] = z ** k * (far / reach) ** m;
    fall[p] = 1 / reach ** 2;
    f_r[p] = brdf[node] + Math.min(1, place - node) * (brdf[node + 1] - brdf[node]);
    slant[p] = Math.max(0, cosine);
    linear[p] = gain * light[p] * fall[p] * f_r[p] * slant[p];
    image[p] = Math.min(1, linear[p] ** (1 / gamma));
  }
  return maps;
}
