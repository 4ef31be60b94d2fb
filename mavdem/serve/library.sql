-- One log by the name that a link has; digest is empty for a log that only the fleet has. Lights are levels, modes and tags
-- words between commas, gains JSON by the name of the parameter; claimed is the server that works on it.
create table if not exists entries (
    id text primary key, digest text, path text unique, name text, size integer, kept integer, keep integer, received real,
    stage text, claimed text, problem text,
    sharing text, log_shared integer, note text, tags text,
    vehicle text, date text, duration real, headline text, level text, next_step text,
    motors text, vibration text, tracking text, margins text, power text, estimator text, wind text, log text,
    modes text, motor integer, wind_speed real, gains text, files text, words text
);
create index if not exists by_date on entries (date desc, received desc);
create index if not exists by_stage on entries (stage, received);
create index if not exists by_vehicle on entries (vehicle, date desc);
create index if not exists by_digest on entries (digest);
