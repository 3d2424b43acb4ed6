function thing = wait(service, path, quiet)
%WAIT Follow a job, reconstruction or scan until it is over, and tell how it stands then.
%   THING = steradian.wait(SERVICE, PATH) prints how far it is, unless QUIET is true as the third argument.
%   It is an error when it fails or is cancelled; the message is the service's reason. Ctrl-C ends the waiting, not
%   the work.
    if nargin < 3, quiet = false; end
    shown = '';
    while true
        thing = steradian.request(service, 'GET', path, 'Headers', {'Prefer: wait=2'});
        seen = sprintf('%s: %s %d of %d', thing.state, thing.progress.stage, thing.progress.done, thing.progress.total);
        if ~quiet && ~strcmp(seen, shown)
            fprintf('%s\n', seen);
            shown = seen;
        end
        if any(strcmp(thing.state, {'succeeded', 'complete', 'partial'})), return, end
        if any(strcmp(thing.state, {'failed', 'cancelled', 'aborted', 'interrupted'}))
            code = thing.state;
            why = ['it is ' thing.state];
            if isfield(thing, 'error') && ~isempty(thing.error)
                code = strrep(thing.error.code, '-', '_');
                why = thing.error.detail;
            end
            error(['steradian:' code], '%s: %s', path, why);
        end
    end
end
