-- Indexes of the table "entries", whose columns are the fields of the class Entry.
create unique index if not exists by_id on entries (id);
create unique index if not exists by_path on entries (path);
create index if not exists by_order on entries (sorted_by desc);
create index if not exists by_stage on entries (stage, received);
create index if not exists by_vehicle on entries (vehicle, sorted_by desc);
create index if not exists by_digest on entries (digest);
create index if not exists by_recording on entries (recording_stage);
