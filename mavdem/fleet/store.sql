-- The logs by name. A log with two names has two entries with the same value of log: the key of its content, or its path
-- where the content was not reached. version is that of LogSource, ended that of JobOutcome; tracked says whether its flights
-- are in the table.
create table if not exists logs (
    path text primary key, version text, size integer, key text, log text, ended text, seconds real, megabytes real,
    time_limit real, memory_limit integer, mavdem_version text, tracked integer
);
-- The rows of each log. file is the name of the log in the table, null where it is not in the table; judged is a hash of the
-- baseline and the version of the rules that the row was judged by; brief is the part of the row that an index of all flights
-- shows, page its page.
create table if not exists flights (log text, vehicle text, file text, judged text, row text, brief text, page text);
-- The vehicles that were judged anew since the pages of their flights were last compared with each other.
create table if not exists outdated_pages (vehicle text primary key);
-- Changes of the rows that are not in the table yet, and the vehicles whose rows they are.
create table if not exists unpublished (change integer primary key, vehicle text);
-- The rows of the baseline.
create table if not exists healthy (row text);
-- Names that users have given: to a vehicle, by what its logs call it, and to a flight, by the hash of its log's content.
create table if not exists vehicle_names (vehicle text primary key, name text not null);
create table if not exists flight_names (content text primary key, name text not null);
-- Vehicles that users have assigned to flights whose logs have only a system id, by the hash of the content and the name there.
create table if not exists flight_vehicles (
    content text, logged_name text, vehicle text not null, primary key (content, logged_name)
);
create index if not exists logs_by_log on logs (log);
create index if not exists logs_by_size on logs (size);
-- Indices have all columns that the queries need: a row of the table is so long that looking into it takes ten times as long.
drop index if exists flights_by_log;
drop index if exists flights_by_vehicle;
create index if not exists flights_of_log on flights (log, file, vehicle);
create index if not exists flights_of_vehicle on flights (vehicle, file, judged);
-- What pages show of each vehicle, made when it was judged; charts are made when they are first drawn.
create table if not exists vehicle_parts (vehicle text primary key, version text not null, summary text not null, charts text);
-- The file of the table, by its number, that has the rows of a vehicle.
create table if not exists table_files (vehicle text primary key, number integer not null);
