function scan = upload(service, sensor_data, sensor, kgrid, varargin)
%UPLOAD Make a scan of recorded or simulated data.
%   SCAN = steradian.upload(SERVICE, SENSOR_DATA, SENSOR, KGRID) sends k-Wave's own three variables: SENSOR_DATA
%   (sensor, time), or a struct with that as field p; SENSOR with a mask, binary or Cartesian (2 or 3, sensor);
%   KGRID with dt, dx, dy and dz. The sensors lie on a plane or a line.
%   SCAN = steradian.upload(SERVICE, SENSOR_DATA, POSITIONS, DT) takes positions (sensor, 1 to 3) in m and the time
%   between samples in s instead.
%
%   'SoundSpeed'  in m/s
%   'TimeZero'    of the first sample after the laser's pulse, in s
%   'Order'       'sensor, time' (default), or 'time, y, z' as k-Wave's kspacePlaneRecon takes it; then SENSOR is []
%   'Labels'      struct of texts
%   'Quiet'       true: no progress
%
%   SCAN is what the service says of it; SCAN.id names it.
    given = struct('SoundSpeed', [], 'TimeZero', [], 'Order', 'sensor, time', 'Labels', struct(), 'Quiet', false);
    for k = 1:2:numel(varargin)
        if ~isfield(given, varargin{k})
            error('steradian:invalid_input', 'there is no option %s; there are %s', varargin{k}, ...
                  strjoin(fieldnames(given)', ', '));
        end
        given.(varargin{k}) = varargin{k + 1};
    end
    if isstruct(sensor_data), sensor_data = sensor_data.p; end
    if isnumeric(kgrid), kgrid = struct('dt', kgrid); end
    file = struct('dt', double(kgrid.dt));
    switch given.Order
        case 'sensor, time'
            if isnumeric(sensor)
                check_rows(sensor_data, size(sensor, 1), 'positions');
                file.positions = double(sensor);
            else
                if isstruct(sensor) || isobject(sensor), sensor = sensor.mask; end
                binary = islogical(sensor) || all(sensor(:) == 0 | sensor(:) == 1);
                if binary
                    check_rows(sensor_data, nnz(sensor), 'the mask');
                else
                    check_rows(sensor_data, size(sensor, 2), 'the mask');
                end
                file.mask = double(sensor);
                file = copy_steps(file, kgrid);
            end
        case 'time, y, z'
            sensor_data = permute(sensor_data, [2 3 1]);
            file.dx = double(kgrid.dy);
            file.dy = double(kgrid.dz);
        otherwise
            error('steradian:invalid_input', 'Order is %s; allowed: ''sensor, time'' or ''time, y, z''', given.Order);
    end
    if ~isinteger(sensor_data), sensor_data = single(sensor_data); end
    file.sensor_data = sensor_data;
    if ~isempty(given.SoundSpeed), file.sound_speed = double(given.SoundSpeed); end
    if ~isempty(given.TimeZero), file.time_zero = double(given.TimeZero); end

    name = [tempname() '.mat'];
    tidy = onCleanup(@() delete(name));
    save_file(name, file);
    sent = steradian.request(service, 'POST', '/api/v1/uploads', 'File', name);
    wanted = struct('kind', 'import', 'upload_id', sent.id, 'labels', given.Labels);
    job = steradian.request(service, 'POST', '/api/v1/jobs', 'Json', wanted);
    done = steradian.wait(service, job.links.self, given.Quiet);
    scan = steradian.request(service, 'GET', ['/api/v1/scans/' done.result.scan_id]);
end

function check_rows(data, count, of)
    if size(data, 1) ~= count
        error('steradian:invalid_input', 'sensor_data has %d rows; allowed: %d, the sensors of %s', ...
              size(data, 1), count, of);
    end
end

function file = copy_steps(file, kgrid)
    for axis = {'dx', 'dy', 'dz'}
        if isfield(kgrid, axis{1}) || (isobject(kgrid) && isprop(kgrid, axis{1}))
            if kgrid.(axis{1}) > 0, file.(axis{1}) = double(kgrid.(axis{1})); end
        end
    end
end

function save_file(name, file)
    bytes = 8 * numel(file.sensor_data);
    if bytes < 2^31
        save(name, '-struct', 'file', '-v6');
    elseif exist('OCTAVE_VERSION', 'builtin')
        save('-hdf5', name, '-struct', 'file');
    else
        save(name, '-struct', 'file', '-v7.3');  % only MATLAB can run this line
    end
end
