-- Indexes of the table "entries", whose columns are the fields of the class LibraryEntry.
create unique index if not exists by_id on entries (id);
create unique index if not exists by_path on entries (path);
drop index if exists by_order;
create index if not exists by_upload on entries (received);
create index if not exists by_date on entries (date, received);
create index if not exists by_stage on entries (stage, received);
drop index if exists by_vehicle;
create index if not exists by_vehicle_and_date on entries (vehicle, date, received);
create index if not exists by_flight_time on entries (flight_time, received);
create index if not exists by_distance on entries (distance, received);
create index if not exists by_height on entries (height, received);
drop index if exists by_urgency;
-- With the columns by which the anomaly of a flight's motors is found, which may make it more urgent.
create index if not exists by_urgency_and_flight on entries (urgency, received desc, digest, content, vehicle);
create index if not exists by_wind_speed on entries (wind_speed, received);
create index if not exists by_digest on entries (digest);
create index if not exists by_recording on entries (recording_stage);
-- Hashes of the scripts in pages of flights, of all versions of this program that have served this library.
create table if not exists chart_scripts (hash text primary key);
