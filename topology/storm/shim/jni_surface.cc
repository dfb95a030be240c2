// The native methods of iotcloud.storm.Native: each finds its object by the handle that Java keeps, and turns C++
// exceptions into Java's.
#include <algorithm>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <jni.h>

#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/memory.h>
#include <iotcloud/topology/storm/shim/answer_queue.h>
#include <iotcloud/topology/storm/shim/bolt_host.h>
#include <iotcloud/topology/storm/shim/component_source.h>
#include <iotcloud/topology/storm/shim/grouping_host.h>
#include <iotcloud/topology/storm/shim/parcel.h>
#include <iotcloud/topology/storm/shim/spout_host.h>
#include <iotcloud/topology/storm/value_format.h>

namespace {

using namespace iotcloud::topology::storm;
using iotcloud::topology::Payload;
using iotcloud::topology::Values;
namespace config = iotcloud::config;

/// Of each arena. Less than other processes keep: a JVM's compilers take and free much, too.
constexpr std::size_t most_freed_memory = std::size_t{16} << 20;

JavaVM* machine = nullptr;
jclass native_class = nullptr;      // iotcloud.storm.Native
jclass byte_array_class = nullptr;  // byte[]
jmethodID log_method = nullptr;     // static void log(int level, byte[] part, byte[] text)
jmethodID apply_method = nullptr;   // of iotcloud.storm.NativeTask
jmethodID grow_method = nullptr;
jmethodID add_array_method = nullptr;
jmethodID wake_method = nullptr;

/// A thread of C++ becomes one of Java's for as long as it runs.
struct Attachment {
  ~Attachment() {
    if (attached) machine->DetachCurrentThread();
  }
  bool attached = false;
};

JNIEnv* environment() {
  void* env = nullptr;
  if (machine->GetEnv(&env, JNI_VERSION_10) == JNI_OK) return static_cast<JNIEnv*>(env);
  thread_local Attachment attachment;
  if (machine->AttachCurrentThreadAsDaemon(&env, nullptr) != JNI_OK) return nullptr;
  attachment.attached = true;
  return static_cast<JNIEnv*>(env);
}

/// A Java exception that is under way: the native method returns at once.
struct JavaException {};

void check(JNIEnv* env) {
  if (env->ExceptionCheck() == JNI_TRUE) throw JavaException();
}

std::span<std::byte> buffer_of(JNIEnv* env, jobject buffer) {
  return {static_cast<std::byte*>(env->GetDirectBufferAddress(buffer)),
          static_cast<std::size_t>(env->GetDirectBufferCapacity(buffer))};
}

std::string text_of(JNIEnv* env, jbyteArray bytes) {
  std::string text(static_cast<std::size_t>(env->GetArrayLength(bytes)), '\0');
  env->GetByteArrayRegion(bytes, 0, static_cast<jsize>(text.size()), reinterpret_cast<jbyte*>(text.data()));
  return text;
}

jbyteArray bytes_of(JNIEnv* env, std::string_view text) {
  jbyteArray bytes = env->NewByteArray(static_cast<jsize>(text.size()));
  if (bytes != nullptr)
    env->SetByteArrayRegion(bytes, 0, static_cast<jsize>(text.size()), reinterpret_cast<const jbyte*>(text.data()));
  return bytes;
}

/// Runs a native method's body. What it throws is thrown in Java.
template <typename Call>
auto guarded(JNIEnv* env, Call&& call) -> decltype(call()) {
  const auto raise = [&](const char* what) { env->ThrowNew(env->FindClass("java/lang/RuntimeException"), what); };
  try {
    return call();
  } catch (const JavaException&) {
  } catch (const std::exception& error) {
    raise(error.what());
  } catch (...) {
    raise("C++ threw something that is no std::exception");
  }
  return decltype(call())();
}

/// The iotcloud.storm.NativeTask of a task.
class JavaTask final : public CommandSink {
 public:
  JavaTask(JNIEnv* env, jobject task) : task_(env->NewGlobalRef(task)) {}
  void apply(std::size_t size) override {
    JNIEnv* env = environment();
    check(env);
    env->CallVoidMethod(task_, apply_method, static_cast<jint>(size));
    check(env);
  }
  std::span<std::byte> grow(std::size_t size) override {
    JNIEnv* env = environment();
    check(env);
    jobject buffer = env->CallObjectMethod(task_, grow_method, static_cast<jlong>(size));
    check(env);
    const auto grown = buffer_of(env, buffer);
    env->DeleteLocalRef(buffer);
    return grown;
  }
  void add_array(std::span<const std::byte> bytes) override {
    JNIEnv* env = environment();
    check(env);
    jbyteArray array = bytes_of(env, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
    check(env);
    env->CallVoidMethod(task_, add_array_method, array);
    check(env);
    env->DeleteLocalRef(array);
  }
  void wake() noexcept override {
    if (JNIEnv* env = environment(); env != nullptr) env->CallVoidMethod(task_, wake_method);
  }

 private:
  const jobject task_;
};

/// What a handle of Java points to; it lives until the process ends, as its host does.
struct Task {
  Task(JNIEnv* env, jobject java) : sink(env, java) {}
  JavaTask sink;
  std::span<const std::byte> input;
  std::unique_ptr<SpoutHost> spout;  // either this
  std::unique_ptr<BoltHost> bolt;    // or this
  TaskHost& host() const { return spout ? static_cast<TaskHost&>(*spout) : static_cast<TaskHost&>(*bolt); }
};

/// The object whose address Java keeps as a number.
template <typename Object>
Object& object_at(jlong handle) {
  return *reinterpret_cast<Object*>(handle);  // NOLINT(performance-no-int-to-ptr): JNI has no other way
}

Task& task_at(jlong handle) {
  return object_at<Task>(handle);
}

/// The large payloads of a tuple: a byte[][].
class ArraysOfTuple final : public JavaArrays {
 public:
  ArraysOfTuple(JNIEnv* env, jobjectArray arrays) : env_(env), arrays_(arrays) {}
  Payload next() override {
    if (next_ == env_->GetArrayLength(arrays_)) throw ValueFormatError("there is no further array");
    const auto array = static_cast<jbyteArray>(env_->GetObjectArrayElement(arrays_, next_++));
    const auto size = static_cast<std::size_t>(env_->GetArrayLength(array));
    const std::shared_ptr<std::byte[]> bytes(new std::byte[size]);
    env_->GetByteArrayRegion(array, 0, static_cast<jsize>(size), reinterpret_cast<jbyte*>(bytes.get()));
    env_->DeleteLocalRef(array);
    return Payload::wrap(std::shared_ptr<const void>(bytes, bytes.get()), {bytes.get(), size});
  }

 private:
  JNIEnv* const env_;
  const jobjectArray arrays_;
  jsize next_ = 0;
};

/// A tuple's parcel, whose address Java keeps as a number.
ParcelPtr parcel_at(jlong address) {
  return ParcelPtr(&object_at<Parcel>(address));
}

/// Hands a tuple to its bolt. \param parcel has the values; 0: they are in the first `size` bytes of the task's input
/// and in `arrays`, which is null when there are none.
template <typename Method>
jint hand_over(JNIEnv* env, jlong handle, Method method, jint slot, jint input, jint source_task, jint size,
               jobjectArray arrays, jlong parcel) {
  return guarded(env, [&] {
    const Task& task = task_at(handle);
    const auto call = [&](HandedValues values) {
      return static_cast<jint>(std::invoke(method, *task.bolt, static_cast<std::uint32_t>(slot),
                                           static_cast<std::size_t>(input), source_task, std::move(values)));
    };
    if (parcel != 0) return call({.parcel = parcel_at(parcel)});
    ArraysOfTuple large(env, arrays);
    return call({task.input.first(static_cast<std::size_t>(size)), arrays != nullptr ? &large : nullptr});
  });
}

/// A parcel's values for Java: their bytes, and the arrays that are not among these.
jobjectArray unpack(JNIEnv* env, ParcelPtr parcel) {
  Values& values = parcel->values;
  if (parcel->born_ms) values.add(*parcel->born_ms);
  std::vector<std::optional<JavaValue>> elsewhere;
  find_arrays(values.all(), elsewhere);
  std::string bytes(encoded_size(values.all(), elsewhere), '\0');
  encode_values(values.all(), reinterpret_cast<std::byte*>(bytes.data()), elsewhere);
  const auto arrays =
      std::count_if(elsewhere.begin(), elsewhere.end(), [](const auto& one) { return one.has_value(); });
  jobjectArray all = env->NewObjectArray(static_cast<jsize>(1 + arrays), byte_array_class, nullptr);
  check(env);
  jsize next = 0;
  const auto add = [&](std::string_view of) {
    jbyteArray array = bytes_of(env, of);
    check(env);
    env->SetObjectArrayElement(all, next++, array);
    env->DeleteLocalRef(array);
  };
  add(bytes);
  for (std::size_t i = 0; i < elsewhere.size(); ++i) {
    if (elsewhere[i]) add(std::get<Payload>(values[i]).text());
  }
  return all;
}

struct GroupingTask {
  std::span<const std::byte> input;
  std::span<std::int32_t> chosen;
  std::unique_ptr<GroupingHost> host;
};

AnswerQueue& answers() {
  static AnswerQueue& queue = *new AnswerQueue;
  return queue;
}

void log(config::LogLevel level, std::string_view part, std::string_view text) noexcept {
  JNIEnv* env = environment();
  if (env == nullptr || env->ExceptionCheck() == JNI_TRUE || env->PushLocalFrame(4) != 0) return;
  jbyteArray part_bytes = bytes_of(env, part);
  jbyteArray text_bytes = part_bytes != nullptr ? bytes_of(env, text) : nullptr;
  if (text_bytes != nullptr)
    env->CallStaticVoidMethod(native_class, log_method, static_cast<jint>(level), part_bytes, text_bytes);
  env->ExceptionClear();
  env->PopLocalFrame(nullptr);
}

std::vector<int> ints_of(JNIEnv* env, jintArray array) {
  std::vector<int> ints(static_cast<std::size_t>(env->GetArrayLength(array)));
  env->GetIntArrayRegion(array, 0, static_cast<jsize>(ints.size()), ints.data());
  return ints;
}

}  // namespace

extern "C" {

JNIEXPORT jint JNICALL JNI_OnLoad(JavaVM* vm, void*) {
  machine = vm;
  JNIEnv* env = environment();
  const jclass found = env->FindClass("iotcloud/storm/Native");
  const jclass task = env->FindClass("iotcloud/storm/NativeTask");
  const jclass bytes = env->FindClass("[B");
  if (found == nullptr || task == nullptr || bytes == nullptr) return JNI_ERR;
  byte_array_class = static_cast<jclass>(env->NewGlobalRef(bytes));
  native_class = static_cast<jclass>(env->NewGlobalRef(found));
  log_method = env->GetStaticMethodID(native_class, "log", "(I[B[B)V");
  apply_method = env->GetMethodID(task, "apply", "(I)V");
  grow_method = env->GetMethodID(task, "grow", "(J)Ljava/nio/ByteBuffer;");
  add_array_method = env->GetMethodID(task, "addArray", "([B)V");
  wake_method = env->GetMethodID(task, "wake", "()V");
  if (log_method == nullptr || apply_method == nullptr || grow_method == nullptr || add_array_method == nullptr ||
      wake_method == nullptr)
    return JNI_ERR;
  config::set_log_target(log);
  config::keep_freed_memory(most_freed_memory);
  return JNI_VERSION_10;
}

JNIEXPORT void JNICALL Java_iotcloud_storm_Native_setLogLevel(JNIEnv*, jclass, jint level) {
  config::set_log_level(static_cast<config::LogLevel>(level));
}

JNIEXPORT jlong JNICALL Java_iotcloud_storm_Native_makeTask(JNIEnv* env, jclass, jobject java, jbyteArray description,
                                                            jobject output) {
  return guarded(env, [&]() -> jlong {
    const auto described = TaskDescription::parse(text_of(env, description));
    auto component = component_of(described);
    auto task = std::make_unique<Task>(env, java);
    if (component.spec.spout) {
      task->spout = std::make_unique<SpoutHost>(described, std::move(component), buffer_of(env, output), task->sink);
    } else {
      task->bolt =
          std::make_unique<BoltHost>(described, std::move(component), buffer_of(env, output), task->sink, answers());
    }
    return reinterpret_cast<jlong>(task.release());
  });
}

JNIEXPORT void JNICALL Java_iotcloud_storm_Native_setInput(JNIEnv* env, jclass, jlong handle, jobject input) {
  task_at(handle).input = buffer_of(env, input);
}

JNIEXPORT jboolean JNICALL Java_iotcloud_storm_Native_isSpout(JNIEnv*, jclass, jlong handle) {
  return task_at(handle).spout ? JNI_TRUE : JNI_FALSE;
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_open(JNIEnv* env, jclass, jlong handle) {
  return guarded(env, [&] { return static_cast<jint>(task_at(handle).host().open()); });
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_close(JNIEnv* env, jclass, jlong handle) {
  return guarded(env, [&] { return static_cast<jint>(task_at(handle).host().close()); });
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_execute(JNIEnv* env, jclass, jlong handle, jint slot, jint input,
                                                          jint source_task, jint size, jobjectArray arrays,
                                                          jlong parcel) {
  return hand_over(env, handle, &BoltHost::execute, slot, input, source_task, size, arrays, parcel);
}

JNIEXPORT jobjectArray JNICALL Java_iotcloud_storm_Native_unpack(JNIEnv* env, jclass, jlong parcel) {
  return guarded(env, [&] { return unpack(env, parcel_at(parcel)); });
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_tick(JNIEnv* env, jclass, jlong handle) {
  return guarded(env, [&] { return static_cast<jint>(task_at(handle).bolt->tick()); });
}

JNIEXPORT jlong JNICALL Java_iotcloud_storm_Native_ownTickMicros(JNIEnv*, jclass, jlong handle) {
  return task_at(handle).bolt->own_tick_period().count();
}

JNIEXPORT jboolean JNICALL Java_iotcloud_storm_Native_keeps(JNIEnv*, jclass, jlong handle) {
  return task_at(handle).bolt->keeps() ? JNI_TRUE : JNI_FALSE;
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_keep(JNIEnv* env, jclass, jlong handle, jint slot, jint input,
                                                       jint source_task, jint size, jobjectArray arrays, jlong parcel) {
  return hand_over(env, handle, &BoltHost::keep, slot, input, source_task, size, arrays, parcel);
}

JNIEXPORT void JNICALL Java_iotcloud_storm_Native_requestTick(JNIEnv*, jclass, jlong handle) {
  task_at(handle).bolt->request_tick();
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_runNext(JNIEnv* env, jclass, jlong handle) {
  return guarded(env, [&] { return static_cast<jint>(task_at(handle).bolt->run_next()); });
}

JNIEXPORT void JNICALL Java_iotcloud_storm_Native_endKeeping(JNIEnv*, jclass, jlong handle) {
  task_at(handle).bolt->end_keeping();
}

JNIEXPORT jlong JNICALL Java_iotcloud_storm_Native_awaitAnswers(JNIEnv*, jclass) {
  return reinterpret_cast<jlong>(&answers().wait());
}

JNIEXPORT jlong JNICALL Java_iotcloud_storm_Native_answering(JNIEnv*, jclass, jlong handle) {
  return reinterpret_cast<jlong>(task_at(handle).bolt.get());
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_takeAnswers(JNIEnv* env, jclass, jlong handle) {
  return guarded(env, [&] { return static_cast<jint>(task_at(handle).bolt->take_answers()); });
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_nextTuple(JNIEnv* env, jclass, jlong handle) {
  return guarded(env, [&] { return static_cast<jint>(task_at(handle).spout->next_tuple()); });
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_ack(JNIEnv* env, jclass, jlong handle, jlong id, jlong took,
                                                      jlong times) {
  return guarded(env, [&] {
    return static_cast<jint>(task_at(handle).spout->ack(static_cast<std::uint64_t>(id), std::chrono::nanoseconds(took),
                                                        static_cast<std::uint64_t>(times)));
  });
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_fail(JNIEnv* env, jclass, jlong handle, jlong id) {
  return guarded(env, [&] { return static_cast<jint>(task_at(handle).spout->fail(static_cast<std::uint64_t>(id))); });
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_activate(JNIEnv* env, jclass, jlong handle, jboolean on) {
  return guarded(env, [&] {
    SpoutHost& spout = *task_at(handle).spout;
    return static_cast<jint>(on == JNI_TRUE ? spout.activate() : spout.deactivate());
  });
}

JNIEXPORT jlong JNICALL Java_iotcloud_storm_Native_makeGrouping(JNIEnv* env, jclass, jbyteArray emitter,
                                                                jbyteArray bolt, jint input, jintArray targets) {
  return guarded(env, [&]() -> jlong {
    auto grouping = std::make_unique<GroupingTask>();
    grouping->host = std::make_unique<GroupingHost>(TaskDescription::parse(text_of(env, emitter)), text_of(env, bolt),
                                                    static_cast<std::size_t>(input), ints_of(env, targets));
    return reinterpret_cast<jlong>(grouping.release());
  });
}

JNIEXPORT void JNICALL Java_iotcloud_storm_Native_setGroupingBuffers(JNIEnv* env, jclass, jlong handle, jobject input,
                                                                     jobject chosen) {
  auto& grouping = object_at<GroupingTask>(handle);
  grouping.input = buffer_of(env, input);
  const auto bytes = buffer_of(env, chosen);
  grouping.chosen = {reinterpret_cast<std::int32_t*>(bytes.data()), bytes.size() / sizeof(std::int32_t)};
}

JNIEXPORT jint JNICALL Java_iotcloud_storm_Native_choose(JNIEnv* env, jclass, jlong handle, jint size) {
  return guarded(env, [&] {
    auto& grouping = object_at<GroupingTask>(handle);
    return static_cast<jint>(
        grouping.host->choose(grouping.input.first(static_cast<std::size_t>(size)), grouping.chosen));
  });
}

}  // extern "C"
