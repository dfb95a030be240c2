#include <filesystem>
#include <optional>
#include <string_view>

#include <rocksdb/db.h>
#include <rocksdb/write_batch.h>

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
std::string key_of_task(char kind, const StateOwner& owner) {
  return key_of(kind, owner) + '\0' + as_bytes(static_cast<std::uint64_t>(owner.task_index));
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
    if (const auto count = get_numbers(key_of('t', owner), 1)) {
      check_task_count(owner, static_cast<int>(as_number(*count)));
    }
    StoredState state;
    std::uint64_t expected = 0;
    if (const auto version = get_numbers(key_of_task('v', owner), 2)) {
      state.version = as_number(std::string_view(*version).substr(0, 8));
      expected = as_number(std::string_view(*version).substr(8));
    }
    const std::string prefix = key_of_task('s', owner);
    const std::unique_ptr<rocksdb::Iterator> entry(db_->NewIterator({}));
    for (entry->Seek(prefix); entry->Valid() && entry->key().starts_with(prefix); entry->Next()) {
      const rocksdb::Slice key = entry->key();
      state.entries.emplace(std::string(key.data() + prefix.size(), key.size() - prefix.size()),
                            entry->value().ToString());
    }
    check(entry->status(), "cannot be read");
    if (state.entries.size() != expected) {
      throw problem("is not whole: task " + std::to_string(owner.task_index) + " of \"" + owner.component +
                        "\" should have " + std::to_string(expected) + " keys and has " +
                        std::to_string(state.entries.size()),
                    "restore the folder from a copy, or name another one to begin anew");
    }
    return state;
  }

  void commit(const StateOwner& owner, const Checkpoint& checkpoint) override {
    rocksdb::WriteBatch batch;
    const std::string prefix = key_of_task('s', owner);
    for (const auto& [key, value] : checkpoint.changes) {
      check(value ? batch.Put(prefix + key, *value) : batch.Delete(prefix + key), "cannot take a change");
    }
    check(batch.Put(key_of('t', owner), as_bytes(static_cast<std::uint64_t>(owner.task_count))), "cannot be written");
    check(batch.Put(key_of_task('v', owner), as_bytes(checkpoint.version) + as_bytes(checkpoint.entries)),
          "cannot be written");
    check(db_->Write(synced(), &batch), "cannot be written");
  }

 private:
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
