#include <filesystem>
#include <optional>
#include <string_view>

#include <rocksdb/db.h>
#include <rocksdb/write_batch.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/state/rocksdb/rocksdb_store.h>

namespace iotcloud::topology::internal {

namespace {

// Contents of the database. Numbers are 8 bytes, big endian, so that keys are in order:
//   "format"                                      -> format_name
//   "t" topology 0 component                      -> number of tasks
//   "v" topology 0 component 0 task               -> version, number of entries
//   "s" topology 0 component 0 task key           -> value
constexpr const char* format_key = "format";
constexpr const char* format_name = "iotcloud topology state 1";

std::string as_bytes(std::uint64_t number) {
  std::string bytes(8, '\0');
  for (int i = 7; i >= 0; --i, number >>= 8) bytes[static_cast<std::size_t>(i)] = static_cast<char>(number & 0xff);
  return bytes;
}

std::uint64_t as_number(std::string_view bytes) {
  std::uint64_t number = 0;
  for (const char byte : bytes) number = number << 8 | static_cast<unsigned char>(byte);
  return number;
}

std::string key_of(char kind, const StateOwner& owner) {
  return kind + owner.topology + '\0' + owner.component;
}
std::string key_of_task(char kind, const StateOwner& owner, int task) {
  return key_of(kind, owner) + '\0' + as_bytes(static_cast<std::uint64_t>(task));
}

class RocksdbStore final : public StateStore {
 public:
  RocksdbStore(std::string path, std::unique_ptr<rocksdb::DB> db) : path_(std::move(path)), db_(std::move(db)) {}

  /// Checks that the database has our format; gives a new one our format.
  void check_format() {
    const auto format = get(format_key);
    if (!format) {
      const std::unique_ptr<rocksdb::Iterator> any(db_->NewIterator({}));
      any->SeekToFirst();
      if (any->Valid()) throw problem("holds data of another program", "name a folder that is empty or not there yet");
      check(db_->Put(synced(), format_key, format_name), "cannot be written");
    } else if (*format != format_name) {
      throw problem("has the format \"" + *format + "\" and not \"" + format_name + "\"",
                    "use the version that wrote it, or name another folder");
    }
  }

  StoredState load(const StateOwner& owner) override {
    const config::WriteLock lock(counts_mutex_);
    if (const auto stored = count_of(owner); stored && *stored != owner.task_count) {
      give_to_the_tasks_of(owner, *stored);
    }
    return read(owner, owner.task_index);
  }

  void commit(const StateOwner& owner, const Checkpoint& checkpoint) override {
    rocksdb::WriteBatch batch;
    const std::string prefix = key_of_task('s', owner, owner.task_index);
    for (const auto& [key, value] : checkpoint.changes) {
      check(value ? batch.Put(prefix + key, *value) : batch.Delete(prefix + key), "cannot take a change");
    }
    put_count(batch, owner);
    put_version(batch, owner, owner.task_index, checkpoint.version, checkpoint.entries);
    const config::ReadLock lock(counts_mutex_);
    if (const auto stored = count_of(owner)) check_task_count(owner, *stored);
    check(db_->Write(synced(), &batch), "cannot be written");
  }

 private:
  /// How many tasks the component's state belongs to; nullopt: there is no state.
  std::optional<int> count_of(const StateOwner& owner) const {
    const auto count = get_numbers(key_of('t', owner), 1);
    return count ? std::optional(static_cast<int>(as_number(*count))) : std::nullopt;
  }

  StoredState read(const StateOwner& owner, int task) const {
    StoredState state;
    std::uint64_t expected = 0;
    if (const auto version = get_numbers(key_of_task('v', owner, task), 2)) {
      state.version = as_number(std::string_view(*version).substr(0, 8));
      expected = as_number(std::string_view(*version).substr(8));
    }
    const std::string prefix = key_of_task('s', owner, task);
    const std::unique_ptr<rocksdb::Iterator> entry(db_->NewIterator({}));
    for (entry->Seek(prefix); entry->Valid() && entry->key().starts_with(prefix); entry->Next()) {
      const rocksdb::Slice key = entry->key();
      state.entries.emplace(std::string(key.data() + prefix.size(), key.size() - prefix.size()),
                            entry->value().ToString());
    }
    check(entry->status(), "cannot be read");
    if (state.entries.size() != expected) {
      throw problem("is not whole: task " + std::to_string(task) + " of \"" + owner.component + "\" should have " +
                        std::to_string(expected) + " keys and has " + std::to_string(state.entries.size()),
                    "restore the folder from a copy, or name another one to begin anew");
    }
    return state;
  }

  void put_count(rocksdb::WriteBatch& batch, const StateOwner& owner) const {
    check(batch.Put(key_of('t', owner), as_bytes(static_cast<std::uint64_t>(owner.task_count))), "cannot be written");
  }
  void put_version(rocksdb::WriteBatch& batch, const StateOwner& owner, int task, std::uint64_t version,
                   std::uint64_t entries) const {
    check(batch.Put(key_of_task('v', owner, task), as_bytes(version) + as_bytes(entries)), "cannot be written");
  }

  /// Moves each key to the task that uses it now, in one batch: after a crash all have moved, or none.
  void give_to_the_tasks_of(const StateOwner& owner, int stored) IOTCLOUD_REQUIRES(counts_mutex_) {
    std::vector<StoredState> before;
    before.reserve(static_cast<std::size_t>(stored));
    for (int task = 0; task < stored; ++task) before.push_back(read(owner, task));
    const std::vector<StoredState> given = rehashed(owner, before);
    rocksdb::WriteBatch batch;
    for (int task = 0; task < stored; ++task) {
      check(batch.Delete(key_of_task('v', owner, task)), "cannot take a change");
      for (const auto& [key, value] : before[static_cast<std::size_t>(task)].entries) {
        check(batch.Delete(key_of_task('s', owner, task) + key), "cannot take a change");
      }
    }
    for (int task = 0; task < owner.task_count; ++task) {
      const StoredState& state = given[static_cast<std::size_t>(task)];
      put_version(batch, owner, task, state.version, state.entries.size());
      for (const auto& [key, value] : state.entries) {
        check(batch.Put(key_of_task('s', owner, task) + key, value), "cannot take a change");
      }
    }
    put_count(batch, owner);
    check(db_->Write(synced(), &batch), "cannot be written");
  }

  static rocksdb::WriteOptions synced() {
    rocksdb::WriteOptions options;
    options.sync = true;
    return options;
  }
  StateError problem(const std::string& what, const std::string& remedy) const {
    return StateError("the state store " + path_ + " " + what + "; " + remedy);
  }
  void check(const rocksdb::Status& status, const std::string& what) const {
    if (status.ok()) return;
    throw problem(what + ": " + status.ToString(), "look at the disk and at the file LOG in that folder");
  }
  std::optional<std::string> get(const std::string& key) const {
    std::string value;
    const rocksdb::Status status = db_->Get({}, key, &value);
    if (status.IsNotFound()) return std::nullopt;
    check(status, "cannot be read");
    return value;
  }
  std::optional<std::string> get_numbers(const std::string& key, std::size_t count) const {
    auto value = get(key);
    if (value && value->size() != 8 * count) {
      throw problem(
          "is damaged: a record has " + std::to_string(value->size()) + " bytes and not " + std::to_string(8 * count),
          "restore the folder from a copy, or name another one to begin anew");
    }
    return value;
  }

  const std::string path_;
  const std::unique_ptr<rocksdb::DB> db_;
  /// Held while the numbers of tasks change; checkpoints, which need them as they are, are written side by side.
  config::SharedMutex counts_mutex_;
};

void refuse_foreign(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  if (!fs::exists(path, ignored)) return;
  if (fs::is_directory(path, ignored) && (fs::exists(path + "/CURRENT", ignored) || fs::is_empty(path, ignored))) {
    return;
  }
  throw StateError("the state store " + path +
                   " is no folder of a database, but something else; name a folder that is empty or not there yet");
}

}  // namespace

std::shared_ptr<StateStore> open_rocksdb(const std::string& path) {
  refuse_foreign(path);
  std::error_code failed;
  std::filesystem::create_directories(path, failed);
  if (failed) throw StateError("the state store " + path + " cannot be made: " + failed.message());
  rocksdb::Options options;
  options.create_if_missing = true;
  // A crash may tear the last record, which was never acknowledged; any other damage is an error.
  options.wal_recovery_mode = rocksdb::WALRecoveryMode::kTolerateCorruptedTailRecords;
  options.max_background_jobs = 1;
  options.keep_log_file_num = 2;
  options.stats_dump_period_sec = 0;  // no thread that wakes up for statistics
  options.stats_persist_period_sec = 0;
  rocksdb::DB* db = nullptr;
  const rocksdb::Status status = rocksdb::DB::Open(options, path, &db);
  if (!status.ok()) {
    throw StateError("the state store " + path + " cannot be opened: " + status.ToString() +
                     "; one process at a time may use it, and a damaged one is restored from a copy or replaced");
  }
  auto store = std::make_shared<RocksdbStore>(path, std::unique_ptr<rocksdb::DB>(db));
  store->check_format();
  return store;
}

}  // namespace iotcloud::topology::internal
