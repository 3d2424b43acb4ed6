function service = service(address, key)
%SERVICE Where a Steradian service answers, and the key that lets one in.
%   SERVICE = steradian.service() reads the environment variables STERADIAN_URL (http://127.0.0.1:8000 where there is
%   none) and STERADIAN_KEY.
%   SERVICE = steradian.service(ADDRESS, KEY) says them.
    if nargin < 1, address = getenv('STERADIAN_URL'); end
    if nargin < 2, key = getenv('STERADIAN_KEY'); end
    if isempty(address), address = 'http://127.0.0.1:8000'; end
    service = struct('address', regexprep(address, '/+$', ''), 'key', key);
end
