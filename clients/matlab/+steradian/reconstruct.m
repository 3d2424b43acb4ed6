function image = reconstruct(service, scan, varargin)
%RECONSTRUCT Reconstruct a scan and fetch its volume with axes.
%   IMAGE = steradian.reconstruct(SERVICE, SCAN) with SCAN from steradian.upload, or the identifier of any scan.
%   IMAGE = steradian.reconstruct(SERVICE, SCAN, 'Parameters', P) with a struct of what the service lets one choose,
%   for example struct('method', 'iterative', 'modes', 128, 'depth_range', [1e-3 8e-3]).
%
%   'Axes'   'xyz' (default): IMAGE.p is (x, y, z) with z the depth below the sensors. 'kwave': (x, y, z) as k-Wave
%            has it when its sensors lie in a plane of constant x, so the depth comes first.
%   'Quiet'  true: no progress
%
%   IMAGE has p (single), x, y and z in m along the dimensions of p, report, and id. A line of sensors gives an image
%   with y empty, or with z empty in k-Wave's order.
    given = struct('Parameters', struct(), 'Axes', 'xyz', 'Quiet', false);
    for k = 1:2:numel(varargin)
        if ~isfield(given, varargin{k})
            error('steradian:invalid_input', 'there is no option %s; there are %s', varargin{k}, ...
                  strjoin(fieldnames(given)', ', '));
        end
        given.(varargin{k}) = varargin{k + 1};
    end
    if ~any(strcmp(given.Axes, {'xyz', 'kwave'}))
        error('steradian:invalid_input', 'Axes is %s; allowed: ''xyz'' or ''kwave''', given.Axes);
    end
    if isstruct(scan), scan = scan.id; end
    wanted = struct('scan_id', scan, 'parameters', given.Parameters);
    job = steradian.request(service, 'POST', '/api/v1/reconstructions', 'Json', wanted);
    done = steradian.wait(service, job.links.self, given.Quiet);

    name = tempname();
    tidy = onCleanup(@() delete(name));
    steradian.request(service, 'GET', done.links.volume, 'Output', name, ...
                      'Headers', {'Accept: application/octet-stream'});
    file = fopen(name, 'r', 'ieee-le');
    closing = onCleanup(@() fclose(file));
    values = fread(file, Inf, '*single');

    shape = done.report.shape(:)';
    values = permute(reshape(values, fliplr(shape)), numel(shape):-1:1);  % the bytes have the depth running fastest
    axes = cell(1, numel(shape));
    for k = 1:numel(shape)
        axes{k} = done.report.origin_m(k) + (0:shape(k) - 1) * done.report.spacing_m(k);
    end
    if strcmp(given.Axes, 'kwave')
        values = permute(values, [numel(shape), 1:numel(shape) - 1]);
        axes = axes([numel(shape), 1:numel(shape) - 1]);
    end
    if numel(axes) == 2
        if strcmp(given.Axes, 'kwave'), axes{3} = []; else, axes = {axes{1}, [], axes{2}}; end
    end
    image = struct('p', values, 'x', axes{1}, 'y', axes{2}, 'z', axes{3}, 'report', done.report, 'id', done.id);
end
