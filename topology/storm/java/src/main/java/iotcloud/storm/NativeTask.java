package iotcloud.storm;

import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.List;
import java.util.concurrent.locks.Lock;
import java.util.concurrent.locks.LockSupport;

/**
 * A task's half in Java: the buffers that it shares with C++, and how the commands are applied that C++ left there
 * (topology/storm/shim/command_writer.h). One call at a time.
 */
final class NativeTask {
  private static final int BUFFER_SIZE = 1 << 20;
  private static final byte EMIT_OF_BOLT = 1;
  private static final byte ACK = 2;
  private static final byte FAIL = 3;
  private static final byte RESET = 4;
  private static final byte FORGET = 5;
  private static final byte ERROR = 6;
  private static final byte EMIT_OF_SPOUT = 7;
  private static final byte EXECUTES = 8;
  private static final int PARCEL = -1; // in place of a count of values

  /** What commands are about. */
  interface Collector extends ValueReader.Kept {
    /** Who emits and answers has it. */
    Lock lock();

    /** The commands that follow are of the execute() of this tuple. */
    void executes(int slot);

    /** Returns the tasks that got the tuple. */
    List<Integer> emit(String stream, int task, int[] anchors, int count, List<Object> values);

    /** The same, by a spout. */
    List<Integer> emit(String stream, int task, Long id, List<Object> values);

    void answer(byte command, int slot);

    void reportError(Throwable error);
  }

  static boolean isAck(byte command) {
    return command == ACK;
  }

  static boolean isFail(byte command) {
    return command == FAIL;
  }

  static boolean isReset(byte command) {
    return command == RESET;
  }

  final long handle;
  final ValueWriter input;
  private final List<Output> outputs;
  private final Collector collector;
  private volatile Thread executor;
  private ByteBuffer output = newBuffer(BUFFER_SIZE);
  private int[] anchors = new int[16];
  private final ValueReader reader;

  /** Makes the component in C++. */
  NativeTask(String description, List<Output> outputs, Collector collector) {
    this.outputs = outputs;
    this.collector = collector;
    this.reader = new ValueReader(collector);
    this.executor = Thread.currentThread();
    handle = Native.makeTask(this, description.getBytes(StandardCharsets.UTF_8), output);
    input = new ValueWriter(BUFFER_SIZE, true, buffer -> Native.setInput(handle, buffer));
  }

  private static ByteBuffer newBuffer(long size) {
    return ByteBuffer.allocateDirect(Math.toIntExact(size)).order(ByteOrder.LITTLE_ENDIAN);
  }

  /** Called by C++, when a command does not fit into the output. */
  ByteBuffer grow(long size) {
    output = newBuffer(size);
    return output;
  }

  /** Called by C++: a value of the next command that it writes. */
  void addArray(byte[] array) {
    reader.addArray(array);
  }

  /** Called by C++, on any thread, when a spout has something to emit. */
  void wake() {
    LockSupport.unpark(executor);
  }

  /**
   * Applies the commands in the first bytes of the output, with the collector's lock; C++ calls it, too, when the output is
   * full.
   */
  void apply(int size) {
    collector.lock().lock();
    try {
      applyHere(size);
    } finally {
      collector.lock().unlock();
    }
  }

  /** As apply(), by a thread that has the lock, or that alone calls this task. */
  void applyHere(int size) {
    output.clear().limit(size);
    while (output.hasRemaining()) {
      byte command = output.get();
      switch (command) {
        case EMIT_OF_BOLT:
          emitOfBolt();
          break;
        case EMIT_OF_SPOUT:
          emitOfSpout();
          break;
        case EXECUTES:
          collector.executes(output.getInt());
          break;
        case ERROR:
          collector.reportError(new ComponentError(reader.text(output)));
          break;
        case ACK:
        case FAIL:
        case RESET:
        case FORGET:
          collector.answer(command, output.getInt());
          break;
        default:
          throw new IllegalStateException("C++ and Java of this jar are of different builds: command " + command);
      }
    }
  }

  private void emitOfBolt() {
    Output to = outputs.get(output.getShort());
    int task = output.getInt();
    int count = output.getInt();
    if (count > anchors.length) {
      anchors = new int[count];
    }
    for (int i = 0; i < count; i++) {
      anchors[i] = output.getInt();
    }
    List<Object> values = values(to);
    to.wasSent(values, collector.emit(to.stream, task, anchors, count, values));
  }

  private void emitOfSpout() {
    Output to = outputs.get(output.getShort());
    int task = output.getInt();
    boolean tracked = output.get() != 0;
    long id = output.getLong();
    List<Object> values = values(to);
    to.wasSent(values, collector.emit(to.stream, task, tracked ? Long.valueOf(id) : null, values));
  }

  private List<Object> values(Output to) {
    int count = output.getInt();
    if (count == PARCEL) {
      return parcel(to);
    }
    List<Object> values = new ArrayList<>(count);
    for (int i = 0; i < count; i++) {
      values.add(reader.value(output));
    }
    return values;
  }

  private Parcel parcel(Output to) {
    long address = output.getLong();
    int size = output.getInt();
    if (to.told.length == 0) {
      return new Parcel(address, size, null);
    }
    Object[] values = new Object[size];
    for (int place : to.told) {
      values[place] = reader.value(output);
    }
    return new Parcel(address, size, values);
  }
}
