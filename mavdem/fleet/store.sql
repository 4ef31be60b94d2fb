-- One log by one name; log is its content's key, or its path where that was not reached; version as of Source, ended as of
-- Outcome; tracked: whether its flights are in the table.
create table if not exists logs (
    path text primary key, version text, size integer, key text, log text, ended text, seconds real, megabytes real,
    time_limit real, memory_limit integer, mavdem_version text, tracked integer
);
-- Its rows; file, the name that they have in the table; judged, beside which baseline.
create table if not exists flights (log text, vehicle text, file text, judged text, row text);
-- Changes of the rows that the table does not have yet.
create table if not exists unpublished (change integer primary key);
-- Rows of the baseline.
create table if not exists healthy (row text);
create index if not exists logs_by_log on logs (log);
create index if not exists logs_by_size on logs (size);
create index if not exists flights_by_log on flights (log);
create index if not exists flights_by_vehicle on flights (vehicle, judged);
