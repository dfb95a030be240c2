package iotcloud.storm;

import java.io.File;
import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.util.Set;
import org.apache.logging.log4j.LogManager;
import org.apache.logging.log4j.core.LoggerContext;
import org.slf4j.Logger;
import org.slf4j.LoggerFactory;

/** The functions of libiotcloud_storm.so. awaitAnswers(), runNext() and keep() may wait; the others return at once. */
final class Native {
  private static final String LOGGER = "iotcloud";
  private static final int LEVEL_PERIOD_MS = 1000;
  // As in config/log.h.
  private static final int DEBUG = 0;
  private static final int INFO = 1;
  private static final int WARN = 2;
  private static final int ERROR = 3;
  private static final int OFF = 4;

  private static boolean loaded;
  private static int level = INFO;

  private Native() {}

  /** Loads the library, once; the same one for all tasks of the process. */
  static synchronized void load(String folder) {
    if (loaded) {
      return;
    }
    System.load(new File(folder, "libiotcloud_storm.so").getAbsolutePath());
    loaded = true;
    followLogLevel();
    Timers.every(LEVEL_PERIOD_MS * 1000L, Native::followLogLevel);
    Egress.start();
  }

  /**
   * C++ writes the lines that one of Storm's loggers of its parts may write, whose levels `storm set_log_level` may change; the
   * logger of each part drops what is not for it.
   */
  private static void followLogLevel() {
    int now = levelOf(LOGGER);
    for (String name : loggersWithLevels()) {
      if (name.startsWith(LOGGER + ".")) {
        now = Math.min(now, levelOf(name));
      }
    }
    if (now != level) {
      level = now;
      setLogLevel(now);
    }
  }

  /** Storm's workers, which change these loggers, use this library, too. */
  private static Set<String> loggersWithLevels() {
    return ((LoggerContext) LogManager.getContext(false)).getConfiguration().getLoggers().keySet();
  }

  private static int levelOf(String name) {
    Logger logger = LoggerFactory.getLogger(name);
    return logger.isDebugEnabled() ? DEBUG : logger.isInfoEnabled() ? INFO : logger.isWarnEnabled() ? WARN
        : logger.isErrorEnabled() ? ERROR : OFF;
  }

  /** Called by C++, on any thread. */
  static void log(int level, byte[] part, byte[] text) {
    Logger logger = LoggerFactory.getLogger(LOGGER + "." + new String(part, StandardCharsets.UTF_8));
    String line = new String(text, StandardCharsets.UTF_8);
    switch (level) {
      case DEBUG:
        logger.debug(line);
        break;
      case INFO:
        logger.info(line);
        break;
      case WARN:
        logger.warn(line);
        break;
      default:
        logger.error(line);
    }
  }

  static native void setLogLevel(int level);

  /** Makes a task's component; throws what C++ throws. The result is the task's handle in the calls below. */
  static native long makeTask(NativeTask task, byte[] description, ByteBuffer output);

  static native void setInput(long task, ByteBuffer input);

  static native boolean isSpout(long task);

  // Each of these returns how many bytes of commands it left in the task's output.
  static native int open(long task);

  static native int close(long task);

  /** `size`, `arrays`: ValueWriter's; or `parcel` has the values, which C++ owns then. */
  static native int execute(long task, int slot, int input, int sourceTask, int size, byte[][] arrays, long parcel);

  /** Copies what is in a parcel, which is gone then: the bytes of the values, and the arrays that are not among these. */
  static native byte[][] unpack(long parcel);

  static native int tick(long task);

  static native int takeAnswers(long task);

  static native int nextTuple(long task);

  /** `took`: nanoseconds since the message was emitted. */
  static native int ack(long task, long id, long took, long times);

  static native int fail(long task, long id);

  static native int activate(long task, boolean on);

  /** Whether an input of the bolt has keep_last: then keep() and requestTick() are called, and a thread calls runNext(). */
  static native boolean keeps(long task);

  /** Queues a tuple. Returns the slot of the tuple that it replaces, which Java acks, or -1. */
  static native int keep(long task, int slot, int input, int sourceTask, int size, byte[][] arrays, long parcel);

  static native void requestTick(long task);

  /** Waits for something to do, and does it. Returns -1 after endKeeping(). */
  static native int runNext(long task);

  static native void endKeeping(long task);

  /** How often the shim ticks the bolt; 0: Storm does, or nobody. */
  static native long ownTickMicros(long task);

  /** Waits until a bolt has answers from threads of C++; returns its answering(). */
  static native long awaitAnswers();

  static native long answering(long task);

  static native long makeGrouping(byte[] emitter, byte[] bolt, int input, int[] targets);

  static native void setGroupingBuffers(long grouping, ByteBuffer input, ByteBuffer chosen);

  /** Returns how many tasks stand in `chosen`. */
  static native int choose(long grouping, int size);
}
