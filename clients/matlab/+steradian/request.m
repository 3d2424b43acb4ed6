function answer = request(service, method, path, varargin)
%REQUEST Send one request to a service and decode what it answers.
%   ANSWER = steradian.request(SERVICE, METHOD, PATH) with PATH as the service writes it in links, '/api/v1/...'.
%
%   'Json', VALUE       body: a struct, or text that is JSON already
%   'File', NAME        body: the bytes of a file
%   'Output', NAME      file for the answer's bytes; ANSWER is then its name
%   'Headers', CELLS    further headers, {'Prefer: wait=5'}
%
%   A refusal is an error whose identifier is steradian:CODE ('-' as '_') and whose message is the service's own. curl
%   (7.76 or newer; part of Windows 10, macOS and Linux) speaks HTTP, so that MATLAB and Octave do the same; key and
%   address are given to it in a file that only you can read, not on a command line.
    given = struct('Json', [], 'File', '', 'Output', '', 'Headers', {{}});
    for k = 1:2:numel(varargin)
        given.(varargin{k}) = varargin{k + 1};
    end
    below = regexprep(service.address, '^https?://[^/]*', '');  % links have a proxy's path in front, as the address has
    if ~isempty(below) && strncmp(path, [below '/'], numel(below) + 1), path = path(numel(below) + 1:end); end
    folder = tempname();
    mkdir(folder);
    if ~ispc(), system(sprintf('chmod 700 ''%s''', folder)); end
    tidy = onCleanup(@() remove(folder));
    output = given.Output;
    if isempty(output), output = fullfile(folder, 'answer'); end
    draft = [output '.part'];
    config = {setting('url', [service.address path]), setting('request', method), setting('output', draft), ...
              'silent', 'show-error', setting('write-out', '%{http_code}'), setting('header', 'Expect:')};
    if ~isempty(service.key), config{end + 1} = setting('header', ['Authorization: Bearer ' service.key]); end
    headers = given.Headers;
    if strcmp(method, 'POST')  % a key makes it safe to send it again
        [~, name] = fileparts(folder);
        headers{end + 1} = ['Idempotency-Key: ' name '-' sprintf('%d', floor(1e6 * now()))];
    end
    if any(strcmp(method, {'GET', 'POST'})) && isempty(given.File)
        config = [config, {'retry = 3', 'retry-connrefused'}];
    end
    if ~isempty(given.Json)
        body = given.Json;
        if ~ischar(body), body = jsonencode(body); end
        write(fullfile(folder, 'body'), body);
        config{end + 1} = setting('data-binary', ['@' fullfile(folder, 'body')]);
        headers{end + 1} = 'Content-Type: application/json';
    elseif ~isempty(given.File)
        config{end + 1} = setting('upload-file', given.File);
        headers{end + 1} = 'Content-Type: application/octet-stream';
    end
    for k = 1:numel(headers)
        config{end + 1} = setting('header', headers{k}); %#ok<AGROW>
    end
    write(fullfile(folder, 'config'), strjoin(config, newline()));
    [code, said] = system(sprintf('curl --config "%s"', fullfile(folder, 'config')));
    if code ~= 0
        error('steradian:unreachable', '%s does not answer: %s', service.address, strtrim(said));
    end
    if str2double(said(end - 2:end)) >= 400
        refuse(draft, said(end - 2:end));
    end
    if ~isempty(given.Output)
        movefile(draft, output);
        answer = output;
    else
        answer = decode(draft);
    end
end

function refuse(file, status)
    problem = decode(file);
    if ~isstruct(problem) || ~isfield(problem, 'code')
        error('steradian:answer', 'the service answered with status %s', status);
    end
    error(['steradian:' strrep(problem.code, '-', '_')], '%s', problem.detail);
end

function value = decode(file)
    value = [];
    if exist(file, 'file')
        text = fileread(file);
        if ~isempty(text), value = jsondecode(text); end
    end
end

function line = setting(name, value)
    value = strrep(strrep(value, '\', '\\'), '"', '\"');
    line = [name ' = "' value '"'];
end

function write(name, text)
    file = fopen(name, 'w');
    closing = onCleanup(@() fclose(file));
    fwrite(file, unicode2native(text, 'UTF-8'), 'uint8');
end

function remove(folder)
    if exist(folder, 'dir')
        old = [];
        if exist('OCTAVE_VERSION', 'builtin'), old = confirm_recursive_rmdir(false); end
        rmdir(folder, 's');
        if ~isempty(old), confirm_recursive_rmdir(old); end
    end
end
