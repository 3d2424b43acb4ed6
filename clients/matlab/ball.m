% A ball's sound, recorded by a grid of sensors, becomes a volume with axes: direct and iterative.
service = steradian.service();

dx = 100e-6; dt = 16e-9; c = 1500; s = 100e-6; depth = 3e-3;
[x, y] = ndgrid((-24:23) * dx, (-24:23) * dx);
R = sqrt(x(:).^2 + y(:).^2 + depth^2);
t = (0:399) * dt;
pulse = @(r) r .* exp(-r.^2 / (2 * s^2)) ./ (2 * R);
sensor_data = pulse(R - c * t) + pulse(R + c * t);

scan = steradian.upload(service, sensor_data, [x(:), y(:)], dt, 'SoundSpeed', c);
direct = steradian.reconstruct(service, scan, 'Parameters', struct('modes', 48));
better = steradian.reconstruct(service, scan, 'Parameters', struct('modes', 48, 'method', 'iterative'));

[~, at] = max(direct.p(:));
[i, j, k] = ind2sub(size(direct.p), at);
fprintf('brightest at %.3f, %.3f, %.3f mm\n', 1e3 * direct.x(i), 1e3 * direct.y(j), 1e3 * direct.z(k));
fprintf('amplitude %.2f direct, %.2f iterative\n', max(direct.p(:)), max(better.p(:)));
